from __future__ import annotations

import numpy as np
import pytest

from slam.fleet.passes import find_passes
from tests.slam.fleet.parts import street_part

BESIDE = [[x, 5.0, 0.0] for x in range(0, 100, 10)]


def test_all_of_the_drive_is_in_view_from_afar_also_its_ends() -> None:
    """Half a stretch before the first place, and beyond the last one what its step is longer than half a stretch."""
    positions = np.array([[50.0, 5.0, 0.0], *[[50.0, 1000.0, 0.0]] * 10])
    part = street_part(positions, ["tree"] * 11, np.ones((11, 1), dtype=bool))
    assert find_passes(part).in_view_m[0, 0] == pytest.approx(12.5 + 95.0 + 7.5, rel=0.02)


def test_a_landmark_beyond_the_reach_of_all_that_were_seen_was_not_passed() -> None:
    seen = np.arange(11)[:, None] < 10
    passes = find_passes(street_part(np.array([*BESIDE, [50.0, 1000.0, 0.0]]), ["tree"] * 11, seen))
    np.testing.assert_array_equal(passes.seen, seen)
    assert passes.in_view_m[-1, 0] == 0.0
    assert (passes.in_view_m[:-1, 0] > 0.0).all()
