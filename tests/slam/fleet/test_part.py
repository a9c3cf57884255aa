from __future__ import annotations

import pytest

from slam.fleet.condensed_map import condense_map
from slam.fleet.part import Part
from tests.helpers.driven_maps import driven_map, town
from tests.slam.fleet.parts import CELL_M, joined, session_parts


@pytest.fixture(scope="module")
def sessions() -> list[Part]:
    drives = (0.0, 200.0), (50.0, 250.0), (150.0, 0.0)
    return session_parts(driven_map(town(), *drive, seed=seed) for seed, drive in enumerate(drives))


@pytest.fixture(scope="module")
def whole(sessions: list[Part]) -> Part:
    (part,) = joined(sessions)
    return part


def test_a_folded_part_has_the_places_of_its_area_and_not_of_each_session(sessions: list[Part], whole: Part) -> None:
    folded = condense_map(whole.saved, cell_m=CELL_M).graph
    assert len(whole.saved.graph.keyframe_ids) == sum(len(each.saved.graph.keyframe_ids) for each in sessions)
    assert len(folded.keyframe_ids) <= 250.0 / CELL_M + 1
