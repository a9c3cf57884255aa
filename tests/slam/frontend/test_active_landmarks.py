"""Which landmarks detections are associated with: how certain each is, how long it is kept, and which two are one."""

from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import ArrayLike

from slam.common.arrays import IntArray
from slam.common.config import Config
from slam.common.geometry import apply, invert
from slam.frontend.active_landmarks import MOVING_ACCELERATION_RANGES, ActiveLandmarks, _useless
from slam.object_map.landmarks import ObjectMap, RetirementReason
from slam.odometry.noise import SLIP_INFLATION
from slam.odometry.noise_scale import GATE
from slam.odometry.pose import OdometryPose
from slam.odometry.track import Correction
from tests.helpers.landmarks import add_landmarks, scan_of
from tests.helpers.poses import pose_at

QUIET = {
    "yaw_sigma": 1e-9,
    "yaw_sigma_by_turn": 0.0,
    "tilt_sigma": 1e-9,
    "min_rotation_sigma_rad": 1e-9,
    "min_translation_sigma_m": 1e-6,
}
WIDE = {"detection": {"farthest_m": 500.0, "common_sigma_m": 0.02}}
SIGMA_M = 0.05
PLACES = np.array([[20.0, 3.0, 0.0], [20.0, -3.0, 0.0], [15.0, 6.0, 0.0], [14.0, -5.0, 0.0]])
AHEAD, NEARER = PLACES[:2], PLACES[:2] - [-0.5, 0.0, 0.0]


def odometry_at(x: float) -> OdometryPose:
    """On a straight line, at 1 m/s."""
    return OdometryPose(round(x * 1e9), pose_at(x), x, 0, 1.0)


class Bench:
    """Active landmarks of a robot on the x axis, whose odometry has only translation noise."""

    def __init__(self, **branches: dict[str, object]) -> None:
        odometry = QUIET | branches.pop("odometry", {})
        self.config = Config.model_validate({"calibration": {"odometry": odometry} | branches})
        self.map = ObjectMap(self.config.calibration.objects)
        self.active = ActiveLandmarks(self.config, self.map)
        self.x = 0.0
        self.active.advance(odometry_at(0.0))

    def add(self, positions: ArrayLike, *, confirmed: bool = True) -> IntArray:
        """Landmarks at ``positions`` (N, 3) m, local frame."""
        rows = add_landmarks(
            self.map, np.array(positions), sigma_m=SIGMA_M, second=self.x, travel_m=self.x, confirmed=confirmed
        )
        self.active.add(rows)
        return rows

    def advance(self, x: float, step_m: float | None = None) -> None:
        for each in [x] if step_m is None else np.arange(self.x + step_m, x + 1e-9, step_m):
            self.active.advance(odometry_at(float(each)))
        self.x = x

    def see(
        self, rows: IntArray, positions: ArrayLike | None = None, *, is_uncertain: bool = False
    ) -> Correction | None:
        """Detect landmarks, where they are or at ``positions`` (N, 3) m, local frame."""
        indices = [self.active.rows.tolist().index(row) for row in rows]
        where = self.active.positions[indices] if positions is None else np.array(positions)
        seen = apply(invert(self.active.T_local_body), where)
        scan = scan_of(seen, sigma_m=SIGMA_M, stamp_ns=round(self.x * 1e9))
        return self.active.update(rows, scan, is_uncertain=is_uncertain)

    def surplus_rows(self) -> list[int]:
        return self.active.rows[self.active.surplus()].tolist()

    def sigma_m(self, row: int) -> float:
        """Of the position of a landmark relative to the robot, the largest of any horizontal direction."""
        index = self.active.rows.tolist().index(row)
        covariance = self.active.predict()[1][index]
        return float(np.sqrt(np.linalg.eigvalsh(covariance[:2, :2])[-1]))


# How certain they are


def test_error_of_a_landmark_changes_with_the_view_of_it() -> None:
    """By the squared ``common_sigma_m`` as the view changes by 1 rad, from whichever steps that is made up."""
    odometry = {"translation_sigma": 1e-9, "translation_sigma_by_time": 0.0}
    detection = {"common_sigma_m": 0.3, "common_height_sigma_m": 0.1}
    bench = Bench(odometry=odometry, detection=detection)
    rows = bench.add([[40.0, 0.0, 0.0], [80.0, 0.0, 0.0]])
    bench.advance(20.0, step_m=0.5)
    covariances = bench.active.predict()[1][rows]
    grown = np.diagonal(covariances, axis1=1, axis2=2) - SIGMA_M**2
    changed_rad = np.log([[2.0], [4.0 / 3.0]])
    np.testing.assert_allclose(grown, changed_rad * np.square([0.3, 0.3, 0.1]), rtol=1e-3)


def test_one_landmark_tells_the_noise_of_all_steps_since_the_last_correction(monkeypatch: pytest.MonkeyPatch) -> None:
    bench, shares = Bench(odometry={"translation_sigma": 0.04}, detection={"common_sigma_m": 0.0}), []
    monkeypatch.setattr(
        bench.active._noise, "add", lambda innovation, effects: shares.append(np.sum(effects[:, 1:] ** 2, axis=0))
    )
    rows = bench.add([[5.0, 2.0, 0.0]])
    bench.advance(4.0, step_m=1.0)
    bench.see(rows)
    bench.see(rows)
    bench.advance(8.0, step_m=1.0)
    bench.active.restart()
    bench.see(bench.add([[12.0, 2.0, 0.0]]))
    variance = 4.0 * 0.04**2
    np.testing.assert_allclose(shares[0], variance / (variance + 2.0 * SIGMA_M**2), rtol=1e-6)
    np.testing.assert_array_equal(shares[1:], np.zeros((2, 2)))


def test_odometry_that_slipped_errs_by_more_until_the_next_correction(monkeypatch: pytest.MonkeyPatch) -> None:
    bench, learned = Bench(odometry={"translation_sigma": 0.04}, detection={"common_sigma_m": 0.0}), []
    monkeypatch.setattr(bench.active._noise, "add", lambda *_: learned.append(bench.x))
    rows = bench.add([[5.0, 2.0, 0.0], [9.0, -3.0, 0.0]])
    bench.advance(4.0)
    before = bench.active.predict()[1]
    expected = before + np.diag([1.0, 1.0, 0.0]) * (SLIP_INFLATION**2 - 1.0) * 4.0 * 0.04**2
    np.testing.assert_allclose(bench.active.predict_slipped()[1], expected, atol=1e-9)
    for _ in range(2):  # it slips once
        bench.active.slip()
        np.testing.assert_allclose(bench.active.predict()[1], expected, atol=1e-9)
        np.testing.assert_allclose(bench.active.predict_slipped()[1], expected, atol=1e-9)
    bench.see(rows)
    assert learned == [], "a slip tells nothing of the noise"
    bench.advance(5.0)
    assert (bench.active.predict_slipped()[1][:, 0, 0] > bench.active.predict()[1][:, 0, 0]).all()
    bench.see(rows)
    assert learned == [5.0]


def test_useless_odometry_errs_by_the_sensor_range_or_half_a_turn_over_that_travel() -> None:
    config = Bench(odometry={"yaw_sigma": 0.2}).config
    odometry, range_m = config.calibration.odometry, config.sensor_range_m
    variances = _useless(config) * np.square([odometry.translation_sigma, odometry.yaw_sigma]) * range_m
    np.testing.assert_allclose(variances, np.square([range_m, np.pi]))


def test_moving_landmark_is_expected_where_its_velocity_takes_it() -> None:
    bench = Bench()
    bench.add(AHEAD, confirmed=False)
    bench.map.assign(np.array([0]), velocity_local=[2.0, 0.0, 0.0])
    bench.advance(1.5)
    positions, covariances = bench.active.predict()
    np.testing.assert_allclose(positions, [[23.0, 3.0, 0.0], [20.0, -3.0, 0.0]])
    swerve_m = MOVING_ACCELERATION_RANGES * bench.config.sensor_range_m * 1.5**2
    np.testing.assert_allclose(covariances[0] - covariances[1], swerve_m**2 * np.eye(3), atol=1e-3)


# How long they are kept


def test_landmark_far_from_the_robot_is_surplus() -> None:
    bench = Bench(detection={"farthest_m": 10.0})
    bench.add([[5.0, 2.0, 0.0], [15.0, 2.0, 0.0]])
    bench.advance(26.0)
    assert bench.surplus_rows() == [0]


def test_too_many_landmarks_are_surplus_the_longest_unseen_first(monkeypatch: pytest.MonkeyPatch) -> None:
    """Confirmed and tentative ones are counted apart."""
    monkeypatch.setattr("slam.frontend.active_landmarks.MAX_LANDMARKS", 10)
    bench = Bench(**WIDE)
    bench.add([[float(i), 5.0, 0.0] for i in range(3)])
    bench.add([[float(i), 9.0, 0.0] for i in range(8)], confirmed=False)
    bench.advance(2.0)
    bench.add([[float(i), -5.0, 0.0] for i in range(9)])
    assert bench.surplus_rows() == [0, 1]


# What corrects the robot


@pytest.mark.parametrize(
    ("confirmed", "is_uncertain", "x"),
    [(True, False, 9.5), (True, True, 9.5), (False, False, 10.0), (False, True, 9.5)],
)
def test_landmarks_correct_the_robot_if_confirmed_or_its_pose_is_uncertain(
    confirmed: bool, is_uncertain: bool, x: float
) -> None:
    bench = Bench(**WIDE)
    rows = bench.add(AHEAD, confirmed=confirmed)
    bench.advance(10.0)
    bench.see(rows, NEARER, is_uncertain=is_uncertain)
    assert bench.active.T_local_body[0, 3] == pytest.approx(x, abs=0.05)
    np.testing.assert_allclose(bench.active.T_local_odom @ pose_at(10.0), bench.active.T_local_body, atol=1e-12)


@pytest.mark.parametrize(("speed_mps", "retires"), [(1e-3, False), (0.0, True)], ids=["moving", "retired"])
def test_moving_and_retired_landmarks_do_not_correct_the_robot(speed_mps: float, retires: bool) -> None:
    bench = Bench()
    rows = bench.add(AHEAD, confirmed=False)
    bench.map.assign(rows, velocity_local=[speed_mps, 0.0, 0.0])
    if retires:
        bench.map.retire(rows, RetirementReason.MOVING)
    bench.advance(10.0)
    bench.see(rows, NEARER, is_uncertain=True)
    assert bench.active.T_local_body[0, 3] == 10.0
    assert (bench.map.rows["position_local"][rows, 0] > (20.3 if speed_mps else 20.0)).all()


def test_shift_corrects_the_odometry_and_not_what_the_landmarks_correct_it_by() -> None:
    bench = Bench()
    rows = bench.add(AHEAD)
    bench.advance(10.0)
    bench.see(rows, NEARER)
    before, T_local_odom = bench.active.T_local_body, bench.active.T_local_odom
    T_shift = pose_at(1.0, 2.0, yaw=0.3)
    T_odom = bench.active.shift(T_shift, np.zeros((6, 6)))
    np.testing.assert_allclose(bench.active.T_local_body, T_shift @ before)
    np.testing.assert_allclose(bench.active.T_local_odom, T_local_odom, atol=1e-12)
    np.testing.assert_allclose(bench.active.T_odom_body, T_odom @ pose_at(10.0))
    np.testing.assert_allclose(bench.active.at(odometry_at(9.0)), T_local_odom @ pose_at(9.0), atol=1e-12)


def test_innovation_ratio_of_detections_is_their_median_squared_distance_by_the_gate() -> None:
    bench = Bench()
    bench.see(bench.add(PLACES[:3]), PLACES[:3] + [[0.1], [0.2], [9.0]] * np.eye(1, 3))
    assert bench.active.innovation_ratios["detections"] == pytest.approx(0.5 * (0.2 / SIGMA_M) ** 2 / GATE)


def test_height_that_all_landmarks_seem_to_gain_is_no_slip() -> None:
    bench = Bench(odometry={"min_translation_sigma_m": 0.1})
    rows = bench.add(PLACES)
    bench.advance(10.0)
    assert bench.see(rows, PLACES - [0.0, 0.0, -4.0]) is None
    np.testing.assert_array_equal(bench.active.T_odom_body, pose_at(10.0))


def test_slip_that_all_landmarks_show_corrects_the_odometry() -> None:
    bench = Bench()
    rows = bench.add(PLACES)
    bench.advance(10.0)
    bench.active.slip()
    correction = bench.see(rows, PLACES - [4.0, 0.0, 0.0])
    np.testing.assert_allclose(correction.T_odom[:3, 3], [4.0, 0.0, 0.0], atol=0.7)
    assert correction.variances[0] == pytest.approx(np.sum(correction.T_odom[:3, 3] ** 2) / 2.0)
    np.testing.assert_allclose(bench.active.T_odom_body, correction.T_odom @ pose_at(10.0))
    np.testing.assert_allclose(bench.active.T_local_odom, np.eye(4), atol=0.1)
    bench.active.advance(replace(odometry_at(11.0), T_odom_body=correction.T_odom @ pose_at(11.0)))
    assert bench.see(rows) is None


def test_error_that_a_shift_has_corrected_is_no_slip() -> None:
    bench = Bench()
    rows = bench.add(PLACES)
    bench.advance(10.0)
    bench.active.shift(np.eye(4), np.zeros((6, 6)))
    assert bench.see(rows, PLACES - [4.0, 0.0, 0.0]) is None
