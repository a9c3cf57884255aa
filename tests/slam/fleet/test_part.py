from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from slam.fleet.part import Part, are_saved, fold_part, load_parts, save_parts
from tests.helpers.driven_maps import driven_map, town
from tests.slam.fleet.parts import STRETCH_M, joined, session_parts


@pytest.fixture(scope="module")
def sessions() -> list[Part]:
    drives = (0.0, 200.0), (50.0, 250.0), (150.0, 0.0)
    return session_parts(driven_map(town(), *drive, seed=seed) for seed, drive in enumerate(drives))


@pytest.fixture(scope="module")
def whole(sessions: list[Part]) -> Part:
    (part,) = joined(sessions)
    return part


def test_a_folded_part_is_joined_as_its_sessions_would_be(sessions: list[Part], whole: Part, tmp_path: Path) -> None:
    (both,) = joined(sessions[:2])
    assert not are_saved(tmp_path)
    save_parts(tmp_path, [fold_part(both, stretch_m=STRETCH_M)])
    assert are_saved(tmp_path)
    (late,) = joined([*load_parts(tmp_path), sessions[2]])
    assert late.sessions == whole.sessions == (0, 1, 2)
    assert len(late.objects.ids) == len(whole.objects.ids)
    for number, visit in whole.visits.items():
        assert len(late.visits[number].landmarks) == len(visit.landmarks)
        np.testing.assert_allclose(late.visits[number].steps[..., :2], visit.steps[..., :2], atol=0.05)


def test_a_folded_part_has_the_places_of_its_area_and_not_of_each_session(sessions: list[Part], whole: Part) -> None:
    folded = fold_part(whole, stretch_m=STRETCH_M).saved.graph
    assert len(whole.saved.graph.keyframe_ids) == sum(len(each.saved.graph.keyframe_ids) for each in sessions)
    assert len(folded.keyframe_ids) <= 250.0 / STRETCH_M + 1
