"""Tracking of a drive among landmarks whose odometry is right, jumps, slips or starts anew."""

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
import pytest

from slam.backend.factor_graph import FactorGraph
from slam.common.arrays import FloatArray, IntArray
from slam.common.config import Config
from slam.common.geometry import apply, blend, invert, relative, rotation_angle_rad
from slam.frontend.input.scan import Scan
from slam.frontend.mapper import Mapper
from slam.frontend.tracker import Tracked, Tracker, _anywhere, _Path
from slam.object_map.landmarks import ObjectMap
from slam.odometry.pose import OdometryPose
from slam.odometry.track import Correction
from tests.helpers.landmarks import scan_of
from tests.helpers.poses import pose_at

SIGMA_M = 0.03
RANGE_M = 25.0
STEP_M, STEP_NS = 0.5, 10**8


def forest(count: int = 60, seed: int = 0) -> FloatArray:
    """Places (count, 3) m of objects around the first 30 m of the x axis."""
    rng = np.random.default_rng(seed)
    return np.column_stack([rng.uniform([-20.0, -20.0], [50.0, 20.0], (count, 2)), np.zeros(count)])


def T_true(step: float) -> FloatArray:
    """A gentle curve at 5 m/s, ten scans a second."""
    return pose_at(STEP_M * step, 0.01 * STEP_M * step**1.5, yaw=0.01 * step)


class Drive:
    """A mapper and scans with noise; ``T_fault`` (4, 4) leads from the true frame to that of the odometry.

    ``bursts``: scans come in pairs, the second one a hundredth of a step after the first. ``spacing_m``: of objects of
    a class; where it is given, labels are identities.
    """

    def __init__(
        self, objects: FloatArray, *, range_m: float = RANGE_M, bursts: bool = False, spacing_m: float | None = None
    ) -> None:
        given: dict[str, dict[str, float]] = {"detection": {"common_sigma_m": 0.0}}
        if spacing_m is not None:
            given["objects"] = {"spacing_m": spacing_m}
        config = Config.model_validate({"calibration": given})
        self.are_identities = spacing_m is not None
        self.objects, self.rng, self.range_m, self.bursts = objects, np.random.default_rng(0), range_m, bursts
        object_map = ObjectMap(config.calibration.objects)
        self.mapper = Mapper(config, object_map, FactorGraph())
        self.object_of: dict[int, int] = {}  # of each landmark
        self.T_fault, self.step, self.corrections = np.eye(4), 0, 0
        self.mapper.add_odometry(self.pose())

    def time(self, step: int) -> float:
        """In steps."""
        return step - 0.99 * (step % 2) if self.bursts else step

    def T_body(self, ahead: int = 0) -> FloatArray:
        """The true pose at the step, or so many after it."""
        return T_true(self.time(self.step + ahead))

    def stamp_ns(self) -> int:
        return round(self.time(self.step) * STEP_NS)

    def pose(self, segment: int = 0) -> OdometryPose:
        T = self.T_fault @ self.T_body()
        return OdometryPose(self.stamp_ns(), T, STEP_M * self.time(self.step), segment, 5.0)

    def seen(self) -> IntArray:
        """The objects in range."""
        return np.flatnonzero(np.linalg.norm(self.objects - self.T_body()[:3, 3], axis=1) < self.range_m)

    def nearest(self) -> IntArray:
        """All objects, by their distance at the next step."""
        return np.argsort(np.linalg.norm(self.objects - self.T_body(1)[:3, 3], axis=1))

    def scan(self, which: IntArray) -> Scan:
        positions = apply(invert(self.T_body()), self.objects[which])
        positions += self.rng.normal(scale=SIGMA_M, size=positions.shape)
        labels = [f"tag {each}" if self.are_identities else "tree" for each in which.tolist()]
        return scan_of(positions, labels, sigma_m=SIGMA_M, stamp_ns=self.stamp_ns())

    def located(self, which: IntArray | None = None) -> Tracked:
        """The next scan, tracked and mapped."""
        self.step += 1
        which, pose = self.seen() if which is None else which, self.pose()
        tracked = self.mapper.locate(self.scan(which), pose)
        self.use(tracked, which)
        return tracked

    def rejoined(self) -> Tracked:
        """The next scan, after a step of the odometry that no body can have made."""
        self.step += 1
        tracked = self.mapper.tracker.rejoin(self.scan(self.seen()), self.pose(segment=1), [])
        if not tracked.is_lost:
            self.use(tracked, self.seen())
        return tracked

    def use(self, tracked: Tracked, which: IntArray) -> None:
        if tracked.correction is not None:
            self.T_fault = tracked.correction.T_odom @ self.T_fault
            self.corrections += 1
        self.mapper.add_odometry(self.pose())
        found = self.mapper.add_scan(tracked, self.pose())
        new = {int(row): int(which[k]) for k, row in enumerate(found.landmark_ids) if found.created[k]}
        self.object_of |= new

    def drive(self, steps: int, fault: Callable[[int], FloatArray] = lambda _: np.eye(4)) -> list[Tracked]:
        """So many steps; ``fault`` (4, 4) is added to the odometry at each, in the frame of the body."""
        found = []
        for step in range(steps):
            self.err(fault(step))
            found.append(self.located())
        return found

    def err(self, T_error: FloatArray) -> None:
        """Add an error (4, 4) to the odometry at the next scan, in the frame of the body."""
        body = self.T_body(1)
        self.T_fault = self.T_fault @ body @ T_error @ invert(body)

    def wrong_pairs(self, tracked: Tracked, which: IntArray) -> int:
        """Detections with another object's landmark."""
        rows = tracked.landmark_rows
        return sum(
            self.object_of[row] != each for row, each in zip(rows.tolist(), which.tolist(), strict=True) if row >= 0
        )

    def error(self) -> tuple[float, float]:
        """How far the odometry as corrected is from the truth, in metres and radians."""
        left = relative(self.T_body(), self.pose().T_odom_body)
        return float(np.linalg.norm(left[:3, 3])), float(rotation_angle_rad(left))


def driven(steps: int, **given: Any) -> Drive:
    """A drive through the forest after so many steps."""
    drive = Drive(forest(), **given)
    drive.drive(steps)
    return drive


def turned(*, spacing_m: float | None = None) -> Drive:
    """A drive whose odometry has just turned by 1.5 rad too much."""
    drive = driven(15, spacing_m=spacing_m)
    drive.err(pose_at(yaw=1.5))
    return drive


def known(tracked: Tracked) -> float:
    """Share of the detections of a scan that have a landmark."""
    return float(tracked.assignment.matched.mean())


def gathered_counts(monkeypatch: pytest.MonkeyPatch) -> list[int]:
    """How many earlier scans are gathered from now on, at each scan that is decided by modes."""
    counts, gathered = list[int](), Tracker._gathered

    def counting(tracker: Tracker, tracked: Tracked, pose: OdometryPose, earlier: Sequence[Any]) -> Tracked:
        counts.append(len(earlier))
        return gathered(tracker, tracked, pose, earlier)

    monkeypatch.setattr(Tracker, "_gathered", counting)
    return counts


@pytest.mark.parametrize(
    ("x", "y", "yaw"), [(0.0, 0.0, 0.7), (0.0, 0.0, -2.1), (0.6, -0.5, 0.0), (8.0, 5.0, 1.5)], ids=str
)
def test_jump_of_the_odometry_is_corrected(x: float, y: float, yaw: float) -> None:
    drive = driven(15)
    jump = pose_at(x, y, yaw=yaw)
    found = drive.drive(6, lambda step: jump if step == 0 else np.eye(4))
    assert drive.corrections == 1
    assert known(found[-1]) > 0.95
    assert drive.error()[0] < 0.2
    assert drive.error()[1] < 0.02
    (correction,) = [tracked.correction for tracked in found if tracked.correction is not None]
    translation, _, heading = correction.variances
    assert translation >= 0.9 * (x**2 + y**2) / 3.0
    assert heading >= 0.9 * yaw**2


def test_jump_between_bursts_of_scans_is_corrected_at_once() -> None:
    """The speed within a burst is that of the noise of its scans."""
    drive = driven(15, bursts=True)
    drive.err(pose_at(yaw=1.5))
    near = drive.nearest()[:4]
    tracked = drive.located(near)
    assert drive.corrections == 1
    assert known(tracked) == 1.0
    assert drive.wrong_pairs(tracked, near) == 0


@pytest.mark.parametrize("bursts", [False, True])
def test_slip_is_as_large_as_the_recent_motion(bursts: bool) -> None:
    drive = driven(15, bursts=bursts)
    roll, pitch, turn, x, y, z = np.sqrt(np.diagonal(drive.mapper.tracker._slip(drive.stamp_ns() + STEP_NS)))
    assert 0.005 < turn < 0.03
    assert x == y == pytest.approx(STEP_M, rel=0.2)
    np.testing.assert_allclose([roll, pitch, z], [0.1 * turn, 0.1 * turn, 0.1 * x])


def test_path_goes_on_as_in_the_interval_before_and_its_way_is_at_the_speed_of_all() -> None:
    """Of four scans, the third of which came sooner than others after it."""
    path = _Path()
    poses = {0: pose_at(), 10: pose_at(1.0, yaw=0.1), 14: pose_at(1.5, yaw=0.1), 20: pose_at(2.0, yaw=0.3)}
    for tenths, T in poses.items():
        path.append((10**9 + 10**8 * tenths, T))
    expected = blend(np.eye(4), relative(poses[10], poses[20]), 5.0 / 10.0)
    np.testing.assert_allclose(path.step_until(10**9 + 10**8 * 25), expected, atol=1e-9)
    np.testing.assert_allclose(path.way_until(10**9 + 10**8 * 25), np.array([0.3, 2.0]) * 5.0 / 20.0)


def test_anywhere_is_among_the_landmarks_around_at_any_heading() -> None:
    found = _anywhere(np.array([[1.0, 5.0, 0.0], [4.0, -1.0, 9.0], [2.0, 0.0, 3.0]]), 0.1)
    np.testing.assert_allclose(np.sqrt(np.diagonal(found.added)), [1e-3, 1e-3, np.pi, 3.0, 6.0, 0.6])


def test_slip_is_as_probable_as_slips_were_so_far() -> None:
    """One in a hundred scans before any is seen."""
    drive = driven(9)
    drive.err(pose_at(yaw=1.5))
    drive.drive(1)
    odometry_is_right, slips = drive.mapper.tracker._components(drive.pose(), is_failing=False)
    assert slips.weight == pytest.approx(2.0 / 110.0)
    assert odometry_is_right.weight == pytest.approx(1.0 - slips.weight)


@pytest.mark.parametrize("likelier", [False, True])
def test_odometry_slips_if_that_is_likelier_than_bad_detections(likelier: bool) -> None:
    """One object is in view, off by six standard deviations of a step and a detection."""
    drive = driven(12)
    tracker = drive.mapper.tracker
    which = drive.nearest()[:1]
    sigma_m = float(np.sqrt(tracker.active._variances[1] + 0.05**2 * STEP_M))
    drive.err(pose_at(6.0 * np.hypot(sigma_m, SIGMA_M)))
    tracker._slips, tracker._scans = (1, 100) if likelier else (1, 10**30)
    tracked = drive.located(which)
    assert drive.wrong_pairs(tracked, which) == 0
    assert (tracked.landmark_rows >= 0).tolist() == [likelier]


def test_scans_that_do_not_fit_are_decided_together() -> None:
    """Each has one object, which tells too little by itself."""
    drive = turned(spacing_m=1e6)
    near = drive.nearest()
    before = len(drive.object_of)
    for row in range(3):
        drive.located(near[row : row + 1])
    assert drive.corrections == 1
    assert len(drive.object_of) == before
    assert drive.error()[1] < 0.1


@pytest.mark.parametrize("matches_between", [False, True])
def test_single_objects_that_match_nothing_count_together_until_one_matches(matches_between) -> None:
    drive = driven(12)
    farthest = drive.nearest()[-20:]
    lost = []
    for number in range(3):
        if matches_between and number:
            drive.located(drive.nearest()[:1])
        before = drive.T_fault
        drive.err(pose_at(1.5, -1.0, yaw=0.4))
        lost.append(drive.located(farthest[number : number + 1]).is_lost)
        drive.T_fault = before
    assert lost == [False, not matches_between, not matches_between]


def test_earlier_scans_are_forgotten_once_the_pose_is_sure(monkeypatch) -> None:
    drive = turned(spacing_m=1e6)
    counts = gathered_counts(monkeypatch)
    near = drive.nearest()
    for row in range(3):
        drive.located(near[row : row + 1])
    drive.err(pose_at(yaw=-1.5))
    drive.located(near[3:4])
    assert counts == [0, 1, 0]


@pytest.mark.parametrize("rejoins", [False, True])
def test_scans_before_a_discontinuity_are_not_gathered(monkeypatch, rejoins: bool) -> None:
    drive = turned(spacing_m=1e6)
    assert drive.located(drive.nearest()[:1]).is_lost
    if rejoins:
        assert not drive.rejoined().is_lost
    else:
        drive.mapper.tracker.restart()
    counts = gathered_counts(monkeypatch)
    drive.err(pose_at(yaw=-1.5))
    drive.located()
    assert counts == [0]


def test_pairs_at_a_pose_that_is_not_sure_are_not_used(monkeypatch) -> None:
    """At the pose of the odometry they would drag the landmarks."""
    drive = turned()
    monkeypatch.setattr(Tracker, "_sure_mode", lambda *_: None)
    tracked = drive.located()
    assert tracked.is_lost
    assert not tracked.assignment.matched.any()


def test_frozen_odometry_is_corrected_scan_by_scan() -> None:
    drive = driven(15)
    found = drive.drive(15, lambda _: relative(T_true(drive.step + 1), T_true(drive.step)))
    assert np.mean([known(tracked) for tracked in found]) > 0.9
    assert drive.corrections > 10
    assert drive.error()[0] < 0.3


def test_locate_passes_on_the_slip_that_landmarks_show(monkeypatch) -> None:
    drive = driven(5)
    slip = Correction(np.eye(4), np.ones(3))
    monkeypatch.setattr(drive.mapper.tracker.active, "update", lambda *_, **__: slip)
    assert drive.located().correction is slip


def test_error_while_nothing_was_in_view_is_corrected() -> None:
    """The scan after it matches next to nothing; only a search for any place around finds the pose."""
    drive = driven(12)
    drive.err(pose_at(0.3, 0.3, yaw=0.2))
    drive.located(np.zeros(0, int))
    found = drive.drive(8)
    assert drive.corrections == 1
    assert known(found[-1]) > 0.8
    assert drive.error()[0] < 0.2
    assert drive.error()[1] < 0.02


def test_no_wrong_pair_is_used_where_two_poses_explain_the_scan_as_well() -> None:
    """The odometry slips by half the spacing of a regular row, whose ends are out of sight."""
    drive = Drive(np.array([[0.8 * i - 10.0, 5.0, 0.0] for i in range(80)]), range_m=12.0)
    drive.drive(12)
    drive.err(pose_at(0.4))
    ahead = np.flatnonzero(np.linalg.norm(drive.objects - drive.T_body(1)[:3, 3], axis=1) < 7.0)
    assert drive.wrong_pairs(drive.located(ahead), ahead) == 0


def test_scan_whose_first_pairs_do_not_fit_is_not_lost_if_it_surely_fits_the_odometry(monkeypatch) -> None:
    drive = driven(12)
    first, judge = iter([True]), Tracker._is_failing
    monkeypatch.setattr(Tracker, "_is_failing", lambda self, *scan: next(first, False) or judge(self, *scan))
    tracked = drive.located()
    assert tracked.correction is None
    assert not tracked.is_lost
    assert known(tracked) > 0.9
    np.testing.assert_array_equal(tracked.assignment.log_likelihood_ratios != 0.0, tracked.assignment.matched)


# After a step that no body can have made


@pytest.mark.parametrize("seed", range(5))
def test_unknown_place_is_not_rejoined(seed: int) -> None:
    drive = driven(20)
    drive.T_fault = invert(T_true(drive.step + 1))
    drive.objects = forest(60, seed=9 + seed)[:, [1, 0, 2]] + T_true(drive.step)[:3, 3]
    assert drive.rejoined().is_lost


def test_nothing_is_tracked_at_first_and_after_a_restart() -> None:
    drive = Drive(forest())
    tracker = drive.mapper.tracker
    assert not tracker.is_tracking
    drive.drive(3)
    assert tracker.is_tracking
    tracker.restart()
    assert not tracker.is_tracking
