"""Many rounds through the same streets: the graph stays that of two rounds, and the map is as good."""

import numpy as np
import pytest

from logs.messages import FactorGraphRecord
from slam import graph_condenser
from slam.graph_condenser import find_anchors
from slam.object_map.map_io import load_map, save_map
from tests.helpers.loop_drives import CORNERS, Outcome, furnished, replay_drive
from tests.helpers.short_drives import final_status, records_of

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
    return final_status(outcome.path).counters.get("keyframes_condensed", 0)


def variables(graph: FactorGraphRecord) -> int:
    """Keyframes with an observation or an edge of the odometry."""
    driven = graph.edge_keyframe_ids[np.array(graph.edge_kinds) == "odometry"]
    return len(np.union1d(driven, graph.observation_keyframe_ids))


@pytest.mark.slow
def test_a_graph_that_outgrew_its_map_is_condensed(whole, condensed):
    np.testing.assert_array_equal(condensed.graph.keyframe_ids, whole.graph.keyframe_ids)
    attached = count_condensed(condensed)
    assert attached > 0.25 * len(condensed.graph.keyframe_ids)
    assert variables(condensed.graph) <= len(condensed.graph.keyframe_ids) - attached
    assert variables(condensed.graph) < 0.7 * variables(whole.graph)


@pytest.mark.slow
def test_the_map_is_as_good(whole, condensed):
    assert condensed.ate_m < 1.5 * whole.ate_m
    assert condensed.closures["precision"] == 1.0
    assert condensed.closures["recall"] > whole.closures["recall"] - 0.02
    landmarks, all_landmarks = (each.evaluation.results["landmarks"] for each in (condensed, whole))
    assert landmarks["confirmed_count"] <= all_landmarks["confirmed_count"] + 1


@pytest.mark.slow
def test_a_saved_map_is_without_the_condensed_keyframes(condensed, tmp_path):
    objects, graph = records_of(condensed.path, "/slam/map")[-1], condensed.graph
    save_map(tmp_path / "map.mcap", objects, graph, {})
    saved = load_map(tmp_path / "map.mcap")
    assert len(saved.graph.keyframe_ids) == len(graph.keyframe_ids) - count_condensed(condensed)
    assert set(saved.graph.observation_keyframe_ids.tolist()) == set(graph.observation_keyframe_ids.tolist())
    assert saved.objects.ids == tuple(
        name for name, state in zip(objects.ids, objects.states, strict=True) if state == "confirmed"
    )


def find(seen: list[tuple[int, list[int]]], travel_m: list[float], **limits: list[bool]) -> dict[int, int]:
    """Anchors of keyframes, each given with its id and the landmarks that it observed."""
    everything = np.ones(len(seen), bool)
    return find_anchors(
        [(keyframe, landmark) for keyframe, landmarks in seen for landmark in landmarks],
        np.array([keyframe for keyframe, _ in seen]),
        np.array(travel_m),
        is_settled=np.array(limits.get("is_settled", everything)),
        may_anchor=np.array(limits.get("may_anchor", everything)),
        min_travel_m=50.0,
    )


def test_a_keyframe_is_attached_to_the_one_of_the_second_traversal_that_saw_most_of_its_landmarks():
    first = [(1, [1, 2, 3, 4, 5, 6])]
    second = [(4, [1, 2, 3]), (5, [2, 3, 4, 5]), (6, [2, 3, 4]), (7, [7, 8, 9])]
    seen = [*first, *second, (20, [2, 3, 4, 6])]  # 5 and 6 have three of them each
    assert find(seen, [0.0, 100.0, 110.0, 115.0, 120.0, 200.0]) == {20: 5}


def test_keyframes_of_one_traversal_are_not_attached():
    seen = [(number, [1, 2, 3]) for number in (0, 1, 2)]
    assert find(seen, [0.0, 100.0, 150.0]) == {}
    assert find(seen, [0.0, 100.0, 150.1]) == {2: 1}
    assert find(seen, [0.0, 50.0, 100.1]) == {}


def test_three_common_landmarks_and_half_of_those_seen_are_needed():
    def third(landmarks: list[int], *, of_second: list[int]) -> dict[int, int]:
        return find([(0, of_second), (1, of_second), (2, landmarks)], [0.0, 99.0, 198.0])

    assert third([1, 2, 8, 9], of_second=[1, 2, 3]) == {}
    assert third([1, 2, 3, 4, 5, 6], of_second=[1, 2, 3]) == {2: 1}
    assert third([1, 2, 3, 4, 5, 6, 7], of_second=[1, 2, 3]) == {}


def test_a_keyframe_that_is_not_settled_stays():
    seen = [*enumerate([[1, 2, 3]] * 3)]
    assert find(seen, [0.0, 99.0, 198.0], is_settled=[True, True, False]) == {}


def test_an_attached_keyframe_is_no_anchor_and_neither_is_one_that_may_not_be():
    laps = [*enumerate([[1, 2, 3]] * 5)]
    travel_m = [99.0 * number for number in range(5)]
    assert find(laps, travel_m) == {2: 1, 3: 1, 4: 1}
    assert find(laps, travel_m, may_anchor=[True, False, True, True, True]) == {3: 2, 4: 2}


def test_keyframes_that_saw_nothing_go_with_the_next_one_that_did():
    seen = [*enumerate([*[[1, 2, 3]] * 2, [], [], [1, 2, 3], [], [7, 8]])]
    assert find(seen, [0.0, 99.0, *np.arange(196.0, 201.0)]) == {2: 1, 3: 1, 4: 1}
