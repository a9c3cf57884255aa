from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from slam.common.arrays import FloatArray
from slam.fleet.passes import find_passes
from slam.map_joining.condensed_map import condense_map
from slam.map_joining.part import Part, session_part
from tests.helpers.driven_maps import drive_poses, driven_map, town

FROM_M, TO_M = 0.0, 110.0
"""A straight street."""


@pytest.fixture(scope="module")
def part() -> Part:
    saved = condense_map(driven_map(town(), FROM_M, TO_M, seed=0, stamp_ns=0), stretch_m=25.0)
    return session_part(3, saved)


def placed(part: Part, positions: FloatArray) -> Part:
    """The part with its landmarks at (L, 3) m."""
    return replace(part, saved=replace(part.saved, objects=replace(part.objects, positions=positions)))


def test_all_of_the_drive_is_in_view_from_afar_also_its_ends(part: Part) -> None:
    path = drive_poses(town(), FROM_M, TO_M)[:, :2, 3]
    whole_m = float(np.linalg.norm(np.diff(path, axis=0), axis=1).sum())
    positions = part.objects.positions.copy()
    positions[1:, 0] += 1000.0
    assert abs(find_passes(placed(part, positions)).in_view_m[0, 0] - whole_m) < 0.05 * whole_m


def test_a_landmark_beyond_the_reach_of_all_that_were_seen_was_not_passed(part: Part) -> None:
    positions = part.objects.positions.copy()
    positions[0, 0] += 1000.0
    count = len(positions)
    seen = {name: sessions for name, sessions in part.seen.items() if name != part.objects.ids[0]}
    passes = find_passes(replace(placed(part, positions), seen=seen))
    assert passes.seen.sum() == count - 1
    assert passes.in_view_m[0, 0] == 0.0
    assert (passes.in_view_m[1:, 0] > 0.0).mean() > 0.95
