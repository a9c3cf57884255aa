"""Which landmarks detections are associated with: how long each is kept, and which two are one."""

from __future__ import annotations

import numpy as np
import pytest

from slam.common.arrays import FloatArray, IntArray
from slam.common.config import Config
from slam.common.geometry import transform_from_xyz_yaw
from slam.frontend.active_landmarks import ODOMETRY_INFLATION, UNIQUE_INFLATION, ActiveLandmarks
from slam.frontend.input.scan import Scan
from slam.object_map.landmarks import ObjectMap
from slam.odometry.pose import OdometryPose

QUIET = {"yaw_sigma": 1e-9, "yaw_sigma_by_turn": 0.0, "tilt_sigma": 1e-9, "min_rotation_sigma_rad": 1e-9}
FAR_APART = {"objects": {"spacing_m": 1e3}, "detection": {"farthest_m": 500.0, "common_sigma_m": 0.02}}
SIGMA_M = 0.05


def pose_at(x: float, seconds: float | None = None) -> OdometryPose:
    """On a straight line, at 1 m/s."""
    stamp_ns = round((x if seconds is None else seconds) * 1e9)
    return OdometryPose(stamp_ns, transform_from_xyz_yaw(np.array([x, 0.0, 0.0]), 0.0), x, 0, 1.0)


class Bench:
    """Active landmarks of a robot on the x axis, whose odometry has only translation noise."""

    def __init__(self, **branches: dict[str, object]) -> None:
        odometry = QUIET | branches.pop("odometry", {})
        self.config = Config.model_validate({"calibration": {"odometry": odometry} | branches})
        self.map = ObjectMap(self.config.calibration.objects)
        self.active = ActiveLandmarks(self.config, self.map)
        self.x = 0.0
        self.scan = 0
        self.active.advance(pose_at(0.0))

    def add(self, positions: FloatArray, labels: tuple[str, ...] | None = None, *, confirmed: bool = True) -> IntArray:
        """Landmarks at ``positions`` (N, 3) m, local frame, seen in a scan of their own."""
        self.scan += 1
        positions = np.array(positions, dtype=np.float64)
        rows = self.map.add(
            positions,
            np.tile(SIGMA_M**2 * np.eye(3), (len(positions), 1, 1)),
            self.map.label_indices(labels or ("tree",) * len(positions)),
            stamp_ns=round(self.x * 1e9),
            scan=self.scan,
            travel_m=self.x,
        )
        self.active.add(rows)
        if confirmed:
            self.map.confirm(rows)
            self.active.confirm(rows)
        return rows

    def advance(self, x: float) -> None:
        self.x = x
        self.active.advance(pose_at(x))

    def see(self, rows: IntArray, positions: FloatArray | None = None) -> None:
        """Detect landmarks, where they are or at ``positions`` (N, 3) m, local frame."""
        stamp_ns = round(self.x * 1e9)
        predicted = self.active.predict(stamp_ns)
        indices = np.flatnonzero(np.isin(self.active.rows, rows))
        where = predicted.positions[indices] if positions is None else np.array(positions)
        covariances = np.tile(SIGMA_M**2 * np.eye(3), (len(indices), 1, 1))
        used = np.ones(len(indices), dtype=np.bool_)
        self.active.update(
            indices,
            predicted,
            Scan(stamp_ns, "lidar", where, covariances, ("tree",) * len(where), used, used),
            covariances,
        )

    def uncertain_rows(self) -> list[int]:
        return self.active.rows[self.active.uncertain()].tolist()

    def sigma_m(self, row: int) -> float:
        """Of the position of a landmark relative to the robot, the largest of any horizontal direction."""
        index = self.active.rows.tolist().index(row)
        covariance = self.active.predict(round(self.x * 1e9)).covariances[index]
        return float(np.sqrt(np.linalg.eigvalsh(covariance[:2, :2])[-1]))


# How long they are kept


def test_a_landmark_is_let_go_once_it_is_as_uncertain_as_objects_are_apart():
    """Its variance grows by (inflation * translation_sigma)^2 a metre, here 0.15^2 m^2."""
    bench = Bench(objects={"spacing_m": 1.0}, detection={"farthest_m": 500.0})
    bench.add([[5.0, 2.0, 0.0]])
    for x in np.arange(1.0, 44.0):
        bench.advance(x)
    assert bench.sigma_m(0) == pytest.approx(np.hypot(0.15 * np.sqrt(43.0), SIGMA_M), rel=1e-6)
    assert bench.uncertain_rows() == []
    bench.advance(46.0)
    assert bench.uncertain_rows() == [0]


def test_the_odometry_is_inflated_more_where_objects_are_unique():
    sigmas = []
    for spacing_m in (4.0, 30e3):
        bench = Bench(objects={"spacing_m": spacing_m})
        bench.add([[5.0, 2.0, 0.0]])
        bench.advance(40.0)
        sigmas.append(bench.sigma_m(0) ** 2 - SIGMA_M**2)
    assert sigmas[1] == pytest.approx((UNIQUE_INFLATION / ODOMETRY_INFLATION) ** 2 * sigmas[0])


def test_a_landmark_out_of_sight_stays_certain_while_others_of_its_time_are_in_sight():
    bench = Bench(objects={"spacing_m": 1.0}, detection={"farthest_m": 500.0})
    bench.add([[5.0, 2.0, 0.0], [90.0, 5.0, 0.0], [80.0, -5.0, 0.0]])
    for x in np.arange(1.0, 80.0):
        bench.advance(x)
        bench.see(np.array([1, 2]))
    assert bench.sigma_m(0) < 0.2
    assert bench.uncertain_rows() == []


def test_a_landmark_far_from_the_robot_is_let_go():
    bench = Bench(objects={"spacing_m": 1e3}, detection={"farthest_m": 10.0})
    bench.add([[5.0, 2.0, 0.0], [15.0, 2.0, 0.0]])
    bench.advance(26.0)
    assert bench.uncertain_rows() == [0]


def test_of_too_many_landmarks_those_seen_last_are_kept(monkeypatch):
    monkeypatch.setattr("slam.frontend.active_landmarks.MAX_LANDMARKS", 10)
    bench = Bench(**FAR_APART)
    bench.add([[float(i), 5.0, 0.0] for i in range(3)])
    bench.advance(2.0)
    bench.add([[float(i), -5.0, 0.0] for i in range(9)])
    assert bench.uncertain_rows() == [0, 1]


def test_of_too_many_that_are_confirmed_at_once_the_filter_holds_no_more_than_are_kept(monkeypatch):
    monkeypatch.setattr("slam.frontend.active_landmarks.MAX_LANDMARKS", 10)
    bench = Bench(**FAR_APART)
    bench.add([[float(i), 5.0, 0.0] for i in range(40)])
    assert bench.active.rows.tolist() == list(range(30, 40))
    assert bench.uncertain_rows() == []


def test_a_tentative_landmark_is_never_uncertain():
    bench = Bench(objects={"spacing_m": 0.1}, detection={"farthest_m": 0.5})
    bench.add([[5.0, 2.0, 0.0]], confirmed=False)
    bench.advance(50.0)
    assert bench.uncertain_rows() == []


def test_after_a_restart_there_are_no_landmarks():
    bench = Bench()
    bench.add([[5.0, 2.0, 0.0]])
    bench.active.restart(pose_at(100.0))
    assert len(bench.active.rows) == 0
    np.testing.assert_allclose(bench.active.T_local_body[:3, 3], [100.0, 0.0, 0.0])


# What corrects the robot


def test_confirmed_landmarks_correct_the_robot_and_tentative_ones_do_not():
    shifts = []
    for confirmed in (True, False):
        bench = Bench()
        rows = bench.add([[20.0, 3.0, 0.0], [20.0, -3.0, 0.0]], confirmed=confirmed)
        bench.advance(10.0)
        bench.see(rows, [[20.5, 3.0, 0.0], [20.5, -3.0, 0.0]])
        shifts.append(bench.active.T_local_body[0, 3] - 10.0)
    assert shifts[0] == pytest.approx(-0.5, abs=0.05)
    assert shifts[1] == 0.0


def test_a_landmark_that_is_released_is_still_followed_but_corrects_nothing():
    bench = Bench()
    rows = bench.add([[20.0, 3.0, 0.0], [20.0, -3.0, 0.0]])
    bench.active.release(rows)
    assert bench.active.rows.tolist() == [0, 1]
    bench.advance(10.0)
    bench.see(rows, [[20.5, 3.0, 0.0], [20.5, -3.0, 0.0]])
    assert bench.active.T_local_body[0, 3] == 10.0
    assert bench.map.rows["position_local"][0, 0] > 20.3


def test_a_landmark_that_is_dropped_is_neither():
    bench = Bench()
    bench.add([[20.0, 3.0, 0.0], [20.0, -3.0, 0.0]])
    bench.active.drop(np.array([0]))
    assert bench.active.rows.tolist() == [1]
    assert bench.active.predict(0).positions.shape == (1, 3)


def test_heights_are_as_uncertain_as_the_travel_since_makes_them():
    bench = Bench(odometry={"translation_sigma": 0.1})
    bench.add([[20.0, 3.0, 1.5]])
    bench.advance(9.0)
    prediction = bench.active.predict(round(9e9))
    assert prediction.positions[0, 2] == 1.5
    assert prediction.covariances[0, 2, 2] == pytest.approx(SIGMA_M**2 + 0.1**2 * 9.0)


def test_what_moves_is_expected_where_it_goes_on_to():
    bench = Bench()
    bench.add([[20.0, 3.0, 0.0], [20.0, -3.0, 0.0]], confirmed=False)
    bench.map.assign(np.array([0]), velocity_local=[2.0, 0.0, 0.0])
    prediction = bench.active.predict(round(1.5e9))
    np.testing.assert_allclose(prediction.positions, [[23.0, 3.0, 0.0], [20.0, -3.0, 0.0]])
    assert prediction.covariances[0, 0, 0] > prediction.covariances[1, 0, 0]


# Which are one


def scattered(count: int = 12) -> FloatArray:
    """Places (count, 3) m of objects 20 m apart."""
    return np.array([[20.0 * i, 10.0 * (-1) ** i, 0.0] for i in range(count)])


def test_two_landmarks_of_one_object_are_merged_into_the_older_one():
    bench = Bench(**FAR_APART)
    bench.add(scattered())
    bench.advance(4.0)
    (copy,) = bench.add([[20.1, -10.05, 0.0]]).tolist()
    assert bench.active.merge_duplicates() == [(1, copy)]
    assert copy not in bench.active.rows
    assert len(bench.active.rows) == 12
    merged = bench.map.rows["position_local"][1]
    assert 20.0 < merged[0] < 20.1
    assert bench.active.merge_duplicates() == []


def test_landmarks_of_different_classes_are_never_merged():
    bench = Bench(**FAR_APART)
    bench.add(scattered())
    bench.advance(4.0)
    bench.add([[20.0, -10.0, 0.0]], ("lamp",))
    assert bench.active.merge_duplicates() == []


def test_two_landmarks_are_merged_the_sooner_the_less_is_known_of_how_they_lie():
    """They are 1 m apart; between them the robot drove 40 m without a landmark in sight."""
    for drives_m, expected in ((0.5, 0), (40.0, 1)):
        bench = Bench(**FAR_APART)
        bench.add(3.0 * scattered())
        for x in np.arange(0.5, drives_m + 0.1, 0.5):
            bench.advance(x)
        bench.add([[61.0, -30.0, 0.0]])
        assert len(bench.active.merge_duplicates()) == expected


def test_where_objects_stand_densely_one_next_to_another_is_another():
    """0.6 m apart, relatively known by about 0.45 m: one object among scattered ones, another one in a thicket."""
    for spacing_m, expected in ((20.0, 1), (0.7, 0)):
        bench = Bench(**FAR_APART)
        bench.add(scattered(60) * [spacing_m / 20.0, 0.07, 1.0] if spacing_m < 1.0 else scattered(12))
        for x in np.arange(0.5, 9.1, 0.5):
            bench.advance(x)
        place = bench.map.rows["position_local"][3] + [0.0, 0.6, 0.0]
        bench.add(place[None])
        assert len(bench.active.merge_duplicates()) == expected


def test_two_landmarks_that_were_seen_in_one_scan_are_two():
    bench = Bench(**FAR_APART)
    bench.add(np.concatenate([scattered(), [[20.1, -10.05, 0.0]]]))
    assert bench.active.merge_duplicates() == []


def test_from_a_pose_that_was_not_reached_yet_landmarks_are_less_certain_by_the_way_there():
    bench = Bench(odometry={"translation_sigma": 0.1})
    bench.add([[20.0, 3.0, 0.0]], confirmed=False)
    T_local_body, there = bench.active.predict_from(pose_at(9.0))
    assert T_local_body[0, 3] == pytest.approx(9.0)
    here = bench.active.predict(round(9e9))
    np.testing.assert_allclose(there.positions, here.positions)
    grown = there.covariances[0, 0, 0] - here.covariances[0, 0, 0]
    assert grown == pytest.approx(ODOMETRY_INFLATION**2 * 0.1**2 * 9.0, rel=0.01)
