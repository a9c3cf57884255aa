"""Closures in the graph and in the map: what inserting them ties together, withdrawing them sets free again."""

from dataclasses import fields, replace

import numpy as np
import pytest

from slam.backend.factor_graph import FactorGraph
from slam.backend.factors import Edge, Observation
from slam.common.calibration import ObjectCalibration
from slam.common.config import Config
from slam.loop_closure.accepted_closures import Accepted, AcceptedClosures
from slam.object_map.landmarks import LandmarkState, ObjectMap
from slam.odometry.keyframe import Keyframe
from tests.helpers.candidates import make_candidate
from tests.helpers.landmarks import add_landmarks
from tests.helpers.poses import keyframe_at, pose_at

STATIONS = 5
SPACING_M = 10.0
PASS_M = 300.0
PASSES = 3
DRIFT_M = 3.0


def edge(a: int, b: int, x_m: float, sigma_m: float) -> Edge:
    return Edge(a, b, pose_at(x_m), np.diag(np.repeat([1e-4, sigma_m**2], 3)), "odometry")


class Street:
    """A street of five objects driven three times; each pass sees them as its own and begins where it really began,
    but the odometry puts it 3 m ahead. Keyframe and landmark ``5 * pass + station`` belong together.
    """

    def __init__(self, *, pass_m: float = PASS_M, min_travel_m: float = 100.0) -> None:
        self.pass_m = pass_m
        self.map = ObjectMap(ObjectCalibration())
        self.graph = FactorGraph(kernel_width=1e6)
        self.keyframes: list[Keyframe] = []
        config = Config.model_validate(
            {"loop_closure": {"min_travel_m": min_travel_m}, "calibration": {"detection": {"sensor_range_m": 3.0}}}
        )
        self.closures = AcceptedClosures(config, self.map, self.graph, self.keyframes)
        self.graph.add_keyframe(0, pose_at(0.0))
        for number in range(PASSES * STATIONS):
            self._visit(number)
        self.graph.update()

    def _visit(self, number: int) -> None:
        drive, station = divmod(number, STATIONS)
        if number > 0:
            back_m = SPACING_M if station else DRIFT_M - (STATIONS - 1) * SPACING_M
            self.graph.add_next_keyframe(edge(number - 1, number, back_m, 0.01 if station else 5.0))
        odom_m = drive * DRIFT_M + station * SPACING_M
        travel_m = drive * self.pass_m + station * SPACING_M
        self.keyframes.append(keyframe_at(pose_at(odom_m), number, travel_m=travel_m))
        place, label = np.array([[odom_m, 4.0, 0.0]]), "lamp" if station % 2 else "tree"
        add_landmarks(self.map, place, [label], second=number, scan=number, travel_m=travel_m)
        seen = Observation(number, number, np.array([0.0, 4.0, 0.0]), 0.01 * np.eye(3))
        self.graph.add_observations([seen])

    def close(self, query: int, reference: int, pairs: list[tuple[int, int]]) -> None:
        apart_m = (query % STATIONS - reference % STATIONS) * SPACING_M
        candidate = make_candidate(
            query=self.keyframes[query],
            reference=self.keyframes[reference],
            T_reference_query=pose_at(apart_m),
            sigma=0.3,
            pairs=pairs,
        )
        assert self.closures.add(candidate).inserted
        self.graph.update()

    def fuse(self, kept: int, dropped: int) -> None:
        """Merge two landmarks by no closure."""
        self.map.merge(kept, dropped)
        self.graph.alias_landmarks(self.map.aliases)
        self.graph.update()

    @property
    def accepted(self) -> list[Accepted]:
        return list(self.closures._accepted)

    def revoke(self) -> None:
        self.closures._remove([self.accepted[0]])

    def names(self) -> list[int]:
        return self.map.canonical.tolist()

    def facts(self) -> dict[str, object]:
        """All that the records of the map and the graph say, in an order of its own, estimates apart."""
        count = PASSES * STATIONS
        graph = self.graph.to_record(0, np.arange(count))
        said = self.map.to_record(0)
        edges = zip(
            graph.edge_keyframe_ids.tolist(), graph.edge_kinds, graph.edge_transforms[:, 0, 3].tolist(), strict=True
        )
        observations = zip(graph.observation_keyframe_ids.tolist(), graph.observation_landmark_ids, strict=True)
        return {
            "edges": sorted(edges),
            "observations": sorted(observations),
            "landmarks": self.graph.landmarks.tolist(),
            "map": {field.name: np.asarray(getattr(said, field.name)).tolist() for field in fields(said)},
        }


@pytest.fixture
def street() -> Street:
    return Street()


SAME_STATIONS = [(STATIONS + station, station) for station in range(STATIONS)]


def test_a_closure_ties_its_keyframes_together_as_it_says(street):
    assert street.graph.pose(7)[0, 3] == pytest.approx(2 * SPACING_M + DRIFT_M, abs=1e-3)
    street.close(7, 1, [])
    street.graph.optimize()
    assert street.graph.pose(7)[0, 3] - street.graph.pose(1)[0, 3] == pytest.approx(SPACING_M, abs=0.05)
    record = street.graph.to_record(0, np.arange(PASSES * STATIONS))
    ids = record.edge_keyframe_ids[np.array(record.edge_kinds) == "closure"]
    np.testing.assert_array_equal(ids, [[1, 7]])


def test_a_closure_makes_one_landmark_of_the_two_that_meet(street):
    street.close(7, 2, SAME_STATIONS)
    assert street.names() == [*range(5), *range(5), *range(10, 15)]
    assert street.graph.landmarks.tolist() == [*range(5), *range(10, 15)]
    record = street.map.to_record(0)
    assert record.reasons[7] == "merged into 2"
    assert record.states[7] == "retired"
    assert record.observation_counts.tolist()[:5] == [2] * 5


@pytest.mark.parametrize(
    "closures",
    [
        [(7, 2, [(6, 1), (7, 1)])],
        [(7, 2, [(6, 1)]), (8, 1, [(7, 1)])],
        [(12, 2, [(11, 1)]), (13, 8, [(12, 11)])],
        [(9, 5, [(9, 5), (5, 9)])],
    ],
    ids=["by one closure", "by two", "by way of a third", "of the query's own pass"],
)
def test_two_objects_of_one_pass_never_become_one(street, closures):
    for closure in closures:
        street.close(*closure)
    names = street.names()
    for drive in range(PASSES):
        assert len(set(names[STATIONS * drive : STATIONS * (drive + 1)])) == STATIONS


@pytest.mark.parametrize(
    ("round_m", "min_travel_m", "is_merged"), [(105.0, 100.0, True), (50.0, 40.0, True), (105.0, 110.0, False)]
)
def test_landmarks_are_merged_by_loops_that_may_be_closed(round_m, min_travel_m, is_merged):
    street = Street(pass_m=round_m, min_travel_m=min_travel_m)
    street.close(7, 2, SAME_STATIONS)
    assert street.names() == [*range(5), *(range(5) if is_merged else range(5, 10)), *range(10, 15)]


def test_a_retired_landmark_is_merged_with_nothing(street):
    street.map.assign(np.array([2]), state=LandmarkState.RETIRED)
    street.close(7, 2, [(7, 2)])
    assert street.names() == list(range(PASSES * STATIONS))


def test_withdrawing_closures_in_the_order_of_their_insertion_restores_everything(street):
    before = street.facts()
    street.close(7, 2, SAME_STATIONS)
    street.close(12, 7, [(10 + station, STATIONS + station) for station in range(STATIONS)])
    assert set(street.names()) == set(range(STATIONS))
    street.revoke()
    street.revoke()
    assert street.facts() == before


@pytest.mark.parametrize("pair", [(6, 7), (7, 8)], ids=["dropped", "kept"])
def test_a_fusion_outlives_the_closures_around_it(pair):
    street, alone = Street(), Street()
    street.close(7, 2, [(7, 2), (9, 4)])
    for each in (street, alone):
        each.fuse(*pair)
    street.close(12, 7, [(12, 7), (14, 9)])
    street.revoke()
    assert len({street.names()[row] for row in pair}) == 1
    assert street.names()[2] == 2
    street.revoke()
    assert street.facts() == alone.facts()


def test_a_fusion_does_not_keep_a_landmark_from_being_merged_by_a_closure(street):
    street.fuse(7, 8)
    street.close(7, 2, [(7, 2)])
    assert street.names()[8] == street.names()[7] == 2


def test_a_landmark_that_stands_for_two_passes_is_not_merged_into_a_third(street):
    street.fuse(12, 7)
    street.close(12, 2, [(12, 2)])
    assert street.names()[12] == street.names()[7] == 12
    assert street.names()[2] == 2


def test_segments_are_connected_as_long_as_a_closure_does_it(street):
    for number, keyframe in enumerate(street.keyframes):
        pose_of = replace(keyframe.odometry, segment=number // STATIONS)
        street.keyframes[number] = replace(keyframe, odometry=pose_of)
    street.close(7, 2, [])
    street.close(12, 7, [])
    assert street.closures.is_localized(street.keyframes[14])
    street.revoke()
    assert not street.closures.is_localized(street.keyframes[14])
    assert street.closures._component_of(7) == street.closures._component_of(12)
