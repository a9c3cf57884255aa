"""From scans to landmarks and factors, one small scene at a time."""

from collections import Counter
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from logs.messages import DetectionAssociations, FactorGraphRecord, Odometry
from slam.backend.factor_graph import FactorGraph
from slam.backend.factors import Edge, EdgeKind, Observation
from slam.common.arrays import FloatArray
from slam.common.config import Config
from slam.common.geometry import apply, invert, relative
from slam.frontend.active_landmarks import ActiveLandmarks
from slam.frontend.mapper import BREAK_SIGMA_RAD, BREAK_SIGMA_RANGES, UPDATE_KEYFRAMES, Mapper
from slam.frontend.tracker import Tracked
from slam.object_map.landmarks import LandmarkState, ObjectMap
from slam.odometry.keyframe import Keyframe
from slam.odometry.noise import step_covariance
from slam.odometry.pose import OdometryPose
from slam.odometry.track import OdometryTrack
from tests.helpers.landmarks import scan_of
from tests.helpers.poses import pose_at

OBJECTS = np.array([[10.0, 4.0, 0.0], [12.0, -5.0, 1.0], [25.0, 6.0, 0.5], [5.0, -7.0, 0.0]])
LABELS = ("tree", "lamp", "tree", "bench")


@pytest.fixture
def young(monkeypatch):
    """Landmarks are confirmed although little is known of their speeds."""
    monkeypatch.setattr("slam.frontend.mapper.MOVING_RANGES_PER_S", np.inf)


class Bench:
    """A mapper with a track, driven by hand; objects are given in the odometry frame and seen without noise."""

    def __init__(self, **branches: dict[str, object]) -> None:
        self.config = Config.model_validate({"calibration": branches})
        self.map = ObjectMap(self.config.calibration.objects)
        self.graph = FactorGraph()
        self.mapper = Mapper(self.config, self.map, self.graph)
        self.track = OdometryTrack(self.config.calibration, Counter())

    def move(self, seconds: float, x: float = 0.0) -> Keyframe | None:
        (pose,) = self.track.add(Odometry(round(seconds * 1e9), pose_at(x))) or self.track.finish()
        return self.mapper.add_odometry(pose)

    def locate(
        self, seconds: float, objects: FloatArray = OBJECTS, labels: tuple[str, ...] = LABELS, **detected: Any
    ) -> tuple[Tracked, OdometryPose]:
        pose = self.track.at(round(seconds * 1e9))
        assert pose is not None
        positions = apply(invert(pose.T_odom_body), objects)
        scan = scan_of(positions, labels, stamp_ns=pose.stamp_ns, **({"sigma_m": 0.2} | detected))
        return self.mapper.locate(scan, pose), pose

    def see(self, seconds: float, *seen: Any, **detected: Any) -> DetectionAssociations:
        return self.mapper.add_scan(*self.locate(seconds, *seen, **detected))

    def drive(self, scans: int, *, start: int = 0, step_m: float = 0.5, **seen) -> list[DetectionAssociations]:
        """Ten scans a second, ``step_m`` apart."""
        found = []
        for i in range(start, start + scans):
            self.move(0.1 * i, step_m * i)
            found.append(self.see(0.1 * i, **seen))
        return found

    def states(self) -> list[LandmarkState]:
        return [LandmarkState(state) for state in self.map.rows["state"]]

    def reasons(self) -> list[str]:
        """Why each landmark retired; those that were never confirmed are in no record and so in none of these."""
        return list(self.map.to_record(0).reasons)

    def graph_record(self) -> FactorGraphRecord:
        return self.graph.to_record(0, np.arange(len(self.mapper.keyframes)))

    def observations(self) -> list[Observation]:
        return [factor for factor in self.graph.factors.values() if isinstance(factor, Observation)]


def test_odometry_connects_keyframes():
    bench = Bench()
    bench.drive(13)
    record = bench.graph_record()
    assert record.edge_keyframe_ids.tolist() == [[0, 1], [1, 2], [2, 3]]
    np.testing.assert_allclose(record.edge_transforms[:, 0, 3], 2.0)
    np.testing.assert_allclose(record.T_map_body[:, 0, 3], [0.0, 2.0, 4.0, 6.0], atol=1e-6)


def test_odometry_has_the_noise_that_tracking_finds(monkeypatch):
    factors = np.array([4.0, 9.0])
    monkeypatch.setattr(ActiveLandmarks, "odometry_factors", factors)
    bench = Bench()
    bench.drive(9)
    first, second, *_ = (keyframe.odometry for keyframe in bench.mapper.keyframes)
    edge, *_ = bench.graph.edges(EdgeKind.ODOMETRY).values()
    expected = step_covariance(first, second, bench.config.calibration.odometry, factors)
    np.testing.assert_array_equal(edge.covariance, expected)


def test_graph_is_updated_at_every_few_keyframes(monkeypatch):
    bench, updated = Bench(), list[int]()
    monkeypatch.setattr(bench.graph, "update", lambda: updated.append(len(bench.mapper.keyframes) - 1))
    for number in range(2 * UPDATE_KEYFRAMES + 2):
        bench.move(number, 3.0 * number)
    assert updated == [0, UPDATE_KEYFRAMES, 2 * UPDATE_KEYFRAMES]


def test_landmark_is_confirmed_by_enough_sightings_and_then_enters_the_graph_with_all_of_them(young):
    bench = Bench()
    bench.drive(3)
    assert bench.states() == [LandmarkState.TENTATIVE] * 4
    bench.drive(1, start=3)
    assert bench.states() == [LandmarkState.CONFIRMED] * 4
    assert bench.map.labels.classes(np.arange(4)).tolist() == bench.map.labels.indices(LABELS).tolist()
    assert bench.observations() == []
    bench.mapper.close_keyframe()
    bench.graph.update()
    assert [o.landmark for o in bench.observations()] == [0, 1, 2, 3]
    np.testing.assert_allclose(bench.graph.landmark_positions(np.arange(4)), OBJECTS, atol=1e-6)
    # Four sightings at 0.2 m each went into it.
    np.testing.assert_allclose(bench.observations()[0].covariance, 0.1**2 * np.eye(3), atol=1e-9)


def test_landmark_is_not_confirmed_before_its_speed_is_known_to_half_a_metre_per_second():
    bench = Bench()
    for i in range(13):
        assert all(state == LandmarkState.TENTATIVE for state in bench.states())
        bench.drive(1, start=i, objects=OBJECTS + 1e-6 * i, sigma_m=0.6)  # in the end 0.502 and 0.445 m/s
    assert bench.states() == [LandmarkState.CONFIRMED] * 4


def test_landmark_that_may_be_none_is_not_confirmed(young, monkeypatch):
    monkeypatch.setattr("slam.frontend.mapper.which_exist", lambda rows, seen, scan: seen > 4 - scan)
    bench = Bench()
    bench.drive(4)
    assert bench.states() == [LandmarkState.TENTATIVE, *[LandmarkState.CONFIRMED] * 3]


def test_landmark_seen_too_seldom_is_not_confirmed():
    bench = Bench()
    for i in range(20):
        bench.move(0.1 * i, 0.1 * i)
        bench.see(0.1 * i, *((OBJECTS, LABELS) if i % 4 == 0 else (OBJECTS[:1], LABELS[:1])))
    assert bench.states() == [LandmarkState.CONFIRMED, *[LandmarkState.TENTATIVE] * 3]


def test_share_of_scans_that_confirms_is_half_of_those_in_which_an_object_is_detected_at_most():
    found = [Bench(objects={"detection_probability": each}).mapper._confirm_fraction for each in (0.2, 0.9)]
    assert found == [0.1, 0.4]


def test_scans_of_sensors_that_take_turns_count_as_one(young):
    bench = Bench()
    for i in range(40):
        bench.move(0.1 * i, 0.05 * i)
        one = slice(i % 4, i % 4 + 1)
        bench.see(0.1 * i, OBJECTS[one], LABELS[one], sensor=f"sensor {i % 4}")
    assert bench.states() == [LandmarkState.CONFIRMED] * 4


@pytest.mark.parametrize(("scans", "step_m"), [(20, 0.01), (3, 5.0)], ids=["scans", "distance"])
def test_tentative_landmark_that_is_not_seen_again_is_retired(scans, step_m):
    bench = Bench()
    bench.drive(1, step_m=step_m)
    bench.drive(scans, start=1, step_m=step_m, objects=OBJECTS[:0], labels=())
    assert bench.states() == [LandmarkState.TENTATIVE] * 4
    bench.drive(2, start=1 + scans, step_m=step_m, objects=OBJECTS[:0], labels=())
    assert bench.states() == [LandmarkState.RETIRED] * 4
    bench.mapper.close_keyframe()
    assert bench.observations() == []
    assert bench.map.to_record(0).ids == ()


@pytest.mark.parametrize(
    ("calibration", "is_known"), [({}, True), ({"detection": {"farthest_m": 15.0}}, False)], ids=["near", "far off"]
)
def test_object_seen_again_is_its_landmark_unless_that_was_too_far_off_to_keep(young, calibration, is_known):
    bench = Bench(**calibration)
    bench.drive(6)
    bench.drive(120, start=6, objects=OBJECTS[:0], labels=())
    expected = ("0", "1", "2", "3") if is_known else ("4", "5", "6", "7")
    assert bench.see(12.5).landmark_ids == expected
    assert bench.states()[:4] == [LandmarkState.CONFIRMED] * 4


def test_detection_too_near_to_a_landmark_to_be_new_makes_no_landmark(young):
    bench = Bench()
    bench.drive(12)
    off_m = np.array([[1.3, 0.0, 0.0], [0.0, 0.0, 0.0], [6.0, 0.0, 0.0], [0.0, 0.0, 0.0]])
    associations = bench.drive(1, start=12, objects=OBJECTS[:4] + off_m, labels=LABELS[:4])[0]
    assert associations.landmark_ids == ("", "1", "4", "3")
    assert associations.created.tolist() == [False, False, True, False]


@pytest.mark.parametrize("detection", [{"common_sigma_m": 0.05}, {}], ids=["exact centroids", "defaults"])
def test_two_objects_half_a_metre_apart_that_are_seen_together_stay_two(young, detection):
    bench = Bench(detection=detection)
    pair = np.array([[10.0, 4.0, 0.0], [10.5, 4.0, 0.0], [50.0, -25.0, 0.0], [50.0, 25.0, 0.0]])
    for associations in bench.drive(40, objects=pair, labels=("tree",) * 4, sigma_m=0.05):
        assert associations.landmark_ids == ("0", "1", "2", "3")
    assert bench.map.aliases == {}


def drive_past_a_vehicle(vehicle_m: FloatArray, step_m: float = 0.3, sigma_m: float = 0.2) -> Bench:
    """It is at each ``vehicle_m`` (S,) along x in turn, one a scan."""
    bench = Bench()
    for i, x_m in enumerate(vehicle_m.tolist()):
        bench.move(0.1 * i, step_m * i)
        objects = np.concatenate([OBJECTS, [[3.0 + x_m, 8.0, 0.0]]])
        bench.see(0.1 * i, objects, (*LABELS, "vehicle"), sigma_m=sigma_m)
    bench.mapper.close_keyframe()
    bench.graph.update()
    return bench


@pytest.mark.parametrize("speed_mps", [2.0, 12.0])
def test_moving_vehicle_is_never_in_the_map(speed_mps):
    bench = drive_past_a_vehicle(0.1 * speed_mps * np.arange(40))
    assert bench.states()[:4] == [LandmarkState.CONFIRMED] * 4
    assert LandmarkState.CONFIRMED not in bench.states()[4:]
    assert bench.graph.landmarks.tolist() == [0, 1, 2, 3]


def test_vehicle_that_stops_becomes_a_landmark_where_it_stands():
    bench = drive_past_a_vehicle(0.5 * np.minimum(np.arange(160), 30), step_m=0.02, sigma_m=0.6)
    assert bench.reasons()[4] == "moving"
    confirmed = bench.map.in_state(LandmarkState.CONFIRMED)
    assert len(confirmed) == 5
    np.testing.assert_allclose(bench.map.rows["position_local"][confirmed[-1]], [18.0, 8.0, 0.0], atol=0.1)


def test_followed_vehicle_stays_one_landmark():
    assert len(drive_past_a_vehicle(0.8 * np.arange(40), sigma_m=0.3).map) == 5


def test_landmark_that_turns_out_to_move_leaves_the_graph():
    """It creeps at 0.9 m/s, below the limit, and then goes at 1.6 m/s."""
    scans = np.arange(120)
    vehicle_m = 9.0 + 0.09 * scans + 0.07 * np.maximum(scans - 15, 0)
    assert drive_past_a_vehicle(vehicle_m[:15], step_m=0.1, sigma_m=0.5).graph.landmarks.tolist() == [0, 1, 2, 3, 4]
    bench = drive_past_a_vehicle(vehicle_m, step_m=0.1, sigma_m=0.5)
    assert bench.reasons() == ["", "", "", "", "moving"]
    assert bench.graph.landmarks.tolist() == [0, 1, 2, 3]


def test_detections_between_keyframes_are_placed_by_the_landmarks(young):
    """The odometry slips by 0.3 m, half a metre after the last keyframe."""
    bench = Bench(odometry={"translation_sigma": 0.5})
    bench.drive(9)
    bench.move(0.9, 4.8)
    bench.see(0.9, OBJECTS + np.array([0.3, 0.0, 0.0]))
    bench.mapper.close_keyframe()
    last = bench.mapper.keyframes[-1]
    seen = [each for each in bench.observations() if each.keyframe == last.id]
    off = [each.position[0] + last.odometry.T_odom_body[0, 3] - OBJECTS[each.landmark, 0] for each in seen]
    np.testing.assert_allclose(off, np.zeros(4), atol=0.05)


def test_a_break_at_a_keyframe_begins_a_segment_without_landmarks(young):
    bench = Bench()
    bench.drive(8, objects=OBJECTS[:2], labels=LABELS[:2])
    bench.drive(8, start=8)
    keyframes = bench.mapper.keyframes
    bench.mapper.break_at(keyframes[1])
    kept, ended = LandmarkState.CONFIRMED, LandmarkState.RETIRED
    assert bench.states() == [kept, kept, ended, ended]
    edges = [each for each in bench.graph.factors.values() if isinstance(each, Edge)]
    assert [each.to_keyframe for each in edges if each.kind == EdgeKind.DISCONTINUITY] == [1]
    assert all(each.keyframe == 0 for each in bench.observations())
    assert [each.odometry.segment for each in keyframes] == [0] + [1] * (len(keyframes) - 1)
    bench.see(1.5, OBJECTS)
    assert bench.map.rows["segment"][4:].tolist() == [1] * 4


def test_what_others_were_merged_into_is_not_gone(young):
    bench = Bench()
    bench.drive(6)
    bench.map.merge(0, 1)
    bench.mapper.retire_gone(np.array([0, 2]))
    assert bench.states()[::2] == [LandmarkState.CONFIRMED, LandmarkState.RETIRED]
    assert 2 not in bench.mapper.tracker.active.rows


def test_keyframe_begins_where_odometry_and_landmarks_have_it(monkeypatch):
    bench, steps = Bench(), list[FloatArray | None]()
    add = bench.graph.add_next_keyframe

    def added(edge: Edge, T_first: FloatArray | None = None) -> None:
        steps.append(T_first)
        add(edge, T_first)

    monkeypatch.setattr(bench.graph, "add_next_keyframe", added)
    bench.drive(5)
    bench.move(9.0, 5000.0)
    first, second, _ = bench.mapper.keyframes
    np.testing.assert_allclose(steps[0], relative(first.T_local_body, second.T_local_body))
    assert steps[1] is None


def test_new_segment_of_the_odometry_drops_the_landmarks_in_view():
    bench = Bench()
    bench.drive(10)
    keyframe = bench.move(9.0, 5000.0)
    assert keyframe is not None
    assert LandmarkState.TENTATIVE not in bench.states()
    assert bench.see(9.0, OBJECTS + np.array([5000.0, 0, 0])).created.all()
    bench.graph.update()
    record = bench.graph_record()
    sigmas = np.repeat([BREAK_SIGMA_RAD, BREAK_SIGMA_RANGES * bench.config.sensor_range_m], 3)
    np.testing.assert_allclose(record.edge_covariances[-1], np.diag(sigmas**2))
    assert record.edge_kinds[-1] == "discontinuity"


@pytest.mark.parametrize("share", [0.97, 1.0, 1.03])
@pytest.mark.parametrize("has_own", [False, True])
def test_noise_by_range_is_that_at_the_range_of_the_landmark(has_own, share):
    """And not at the measured one, which is ``share`` of it; noise that a message gives is left alone."""
    bench = Bench(detection={"base_sigma_m": 1e-9, "sigma_per_m": 0.02, "range_sigma_ratio": 1.0})
    bench.drive(12)
    bench.move(1.2, 6.0)
    here = np.array([6.0, 0.0, 0.0])
    tracked, _ = bench.locate(1.2, here + share * (OBJECTS - here), sigma_m=0.2, has_own=has_own)
    assert tracked.landmark_rows.tolist() == [0, 1, 2, 3]
    squares = np.sum((OBJECTS - here) ** 2, axis=1)
    added = np.zeros(4) if has_own else 0.02**2 * (1.0 - share**2) * squares
    np.testing.assert_allclose(tracked.scan.covariances, (0.2**2 + added)[:, None, None] * np.eye(3), atol=1e-6)


def test_landmarks_that_became_inactive_since_a_scan_was_located_are_none_of_its_detections():
    bench = Bench()
    bench.drive(12)
    bench.move(1.2, 6.0)
    tracked, pose = bench.locate(1.2)
    bench.mapper._deactivate(np.arange(4))
    associations = bench.mapper.add_scan(tracked, pose)
    assert associations.landmark_ids == ("",) * 4
    assert not associations.created.any()


def test_associations_have_one_entry_per_detection_of_the_message():
    bench = Bench()
    bench.move(0.0)
    pose = bench.track.latest
    scan = replace(scan_of(OBJECTS[1:3], LABELS[1:3]), used=np.array([False, True, True, False]))
    associations = bench.mapper.add_scan(bench.mapper.locate(scan, pose), pose)
    assert associations.landmark_ids == ("", "0", "1", "")
    assert associations.created.tolist() == [False, True, True, False]
