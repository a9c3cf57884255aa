"""Many rounds through the same streets: the graph stays that of two rounds, and the map is as good."""

from __future__ import annotations

import numpy as np
import pytest

from logs.messages import FactorGraphRecord, ObjectMapRecord, StatusRecord
from slam import graph_condenser
from slam.object_map.map_io import load_map, save_map
from tests.helpers.loop_drives import CORNERS, Outcome, furnished, replay_drive
from tests.helpers.short_drives import records_of

pytestmark = pytest.mark.slow

ROUNDS = 7


@pytest.fixture(scope="module")
def rounds():
    return furnished([CORNERS[name] for name in "ABEF" * ROUNDS], seed=3)


@pytest.fixture(scope="module")
def whole(rounds, tmp_path_factory) -> Outcome:
    return replay_drive(tmp_path_factory.mktemp("whole"), rounds)


@pytest.fixture(scope="module")
def condensed(rounds, tmp_path_factory) -> Outcome:
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(graph_condenser, "MIN_KEYFRAMES", 200)
        return replay_drive(tmp_path_factory.mktemp("condensed"), rounds)


def count_condensed(outcome: Outcome) -> int:
    status = records_of(outcome.path, "/slam/status")[-1]
    assert isinstance(status, StatusRecord)
    return status.counters.get("keyframes_condensed", 0)


def variables(graph: FactorGraphRecord) -> int:
    """Keyframes with an observation or an edge of the odometry."""
    driven = graph.edge_keyframe_ids[np.array(graph.edge_kinds) == "odometry"]
    return len(np.union1d(driven, graph.observation_keyframe_ids))


def test_a_graph_that_is_small_is_left_as_it_is(whole):
    assert count_condensed(whole) == 0
    assert "condensed" not in whole.graph.edge_kinds
    assert variables(whole.graph) == len(whole.graph.keyframe_ids)


def test_a_graph_that_outgrew_its_map_is_condensed(whole, condensed):
    np.testing.assert_array_equal(condensed.graph.keyframe_ids, whole.graph.keyframe_ids)
    attached = count_condensed(condensed)
    assert attached > 0.25 * len(condensed.graph.keyframe_ids)
    assert variables(condensed.graph) <= len(condensed.graph.keyframe_ids) - attached
    assert variables(condensed.graph) < 0.7 * variables(whole.graph)


def test_the_map_is_as_good(whole, condensed):
    assert condensed.ate_m < 1.5 * whole.ate_m
    assert condensed.closures["precision"] == 1.0
    assert condensed.closures["recall"] > whole.closures["recall"] - 0.02
    landmarks, all_landmarks = (each.evaluation.results["landmarks"] for each in (condensed, whole))
    assert landmarks["confirmed_count"] <= all_landmarks["confirmed_count"] + 1


def test_a_saved_map_is_without_the_condensed_keyframes(condensed, tmp_path):
    objects, graph = records_of(condensed.path, "/slam/map")[-1], condensed.graph
    assert isinstance(objects, ObjectMapRecord)
    assert save_map(tmp_path / "map.mcap", objects, graph, {}) == 0
    saved = load_map(tmp_path / "map.mcap")
    assert len(saved.graph.keyframe_ids) == len(graph.keyframe_ids) - count_condensed(condensed)
    assert set(saved.graph.observation_keyframe_ids.tolist()) == set(graph.observation_keyframe_ids.tolist())
    assert saved.objects.ids == tuple(
        name for name, state in zip(objects.ids, objects.states, strict=True) if state == "confirmed"
    )


def test_new_streets_are_not_condensed(tmp_path, monkeypatch):
    monkeypatch.setattr(graph_condenser, "MIN_KEYFRAMES", 60)
    outcome = replay_drive(tmp_path, furnished([(0, 0), (300, 0), (300, 100), (0, 100)], seed=5))
    assert count_condensed(outcome) == 0
