"""Tracking: the pose of the body among the active landmarks at a scan, and the associations of its detections.

Where the odometry predicts the pose better than objects are apart, each detection has one landmark in its gate, and the
optimal assignment is used. Where it does not, or where more detections are unmatched than matched although landmarks
should be in view, the modes of :mod:`slam.frontend.pose_posterior` are compared; what the likeliest ones agree on is
used. Their prior is a mixture: the odometry is right, or it errs by as much as the body moves, or the body is anywhere
around.
"""

from collections import deque
from collections.abc import Sequence
from dataclasses import replace
from itertools import pairwise

import numpy as np
from scipy.spatial.distance import cdist

from logs.records import frozen
from slam.common.arrays import FloatArray, IntArray
from slam.common.calibration import Calibration, DetectionCalibration
from slam.common.geometry import apply, blend, invert, relative, rigid, rotation_angle_rad
from slam.frontend.active_landmarks import ActiveLandmarks
from slam.frontend.data_association import AMBIGUOUS, DECIDED, NEW, Assignment, Objects, associate
from slam.frontend.input.scan import Scan, with_expected_noise
from slam.frontend.pose_posterior import Mode, ModeSearch, PriorComponent, is_same_pose, probabilities
from slam.object_map.landmarks import ObjectMap
from slam.odometry.pose import OdometryPose
from slam.odometry.track import RECENT_STEPS, Correction

PRIOR_SCANS = 100
"""Before any is seen, one step of the odometry in so many is taken to err by as much as the body moves."""
JUMP_PROBABILITY = 1e-4
"""... and one in so many to err by any distance."""
WAITED_SCANS = 2
"""While so many consecutive scans do not fit, nothing new is mapped: the pose may be wrong. By then it has been
searched for everywhere around.
"""
MAX_TURN_RAD = 0.25
"""A pose is used if its rotation errs by less, so that what follows from it is nearly linear in its errors."""
JUMPED = 0.5
"""Probability that a step that no body can have made is wrong."""


@frozen
class Tracked:
    """A scan of D detections in the frame of the body, and as ``seen`` in the local frame.

    ``labels`` (D,): their classes; ``assignment``: to the ``active`` landmarks, rows (A,) of the object map;
    ``correction``: of the odometry at the scan, None where it is right; ``is_lost``: more should have been matched than
    was.
    """

    scan: Scan
    labels: IntArray
    seen: Scan
    active: IntArray
    assignment: Assignment
    correction: Correction | None = None
    is_lost: bool = False

    @property
    def landmark_rows(self) -> IntArray:
        """(D,) row in the object map of each detection's landmark; negative where it has none."""
        rows, matched = self.assignment.landmark_rows.copy(), self.assignment.matched
        rows[matched] = self.active[rows[matched]]
        return rows


class _Path(deque[tuple[int, FloatArray]]):
    """Stamps [ns] and poses (4, 4) of the body among the landmarks at the last scans."""

    def step_until(self, stamp_ns: int) -> FloatArray:
        """The motion (4, 4) from the last scan on, as in the interval before it; scans may come in bursts."""
        now_ns, T_now = self[-1]
        interval_ns = (now_ns - self[0][0]) / max(len(self) - 1, 1)
        before_ns, T_before = next(each for each in reversed(self) if now_ns - each[0] >= interval_ns)
        return blend(np.eye(4), relative(T_before, T_now), (stamp_ns - now_ns) / max(now_ns - before_ns, 1))

    def way_until(self, stamp_ns: int) -> FloatArray:
        """Turn [rad] and length [m] of the way from the last scan, (2,), at the speed of all."""
        if len(self) < 2:
            return np.zeros(2)
        way = np.sum([_size(relative(before, after)) for (_, before), (_, after) in pairwise(self)], axis=0)
        span_ns = max(self[-1][0] - self[0][0], 1)
        return way * (stamp_ns - self[-1][0]) / span_ns


def _size(T: FloatArray) -> FloatArray:
    """Turn [rad] and length [m] of a motion (4, 4)."""
    return np.array([float(rotation_angle_rad(T)), float(np.linalg.norm(T[:3, 3]))])


def _objects(seen: Scan, labels: IntArray, config: DetectionCalibration) -> Objects:
    """Detections with the covariances by which they are assigned: their view of the objects may be any."""
    own = seen.has_own_covariance[:, None, None]
    covariances = seen.covariances + np.where(own, 0.0, np.diag(config.view_variances))
    return Objects(seen.positions, covariances, labels)


def _anywhere(positions: FloatArray, weight: float) -> PriorComponent:
    """Any place among the landmarks around, at ``positions`` (A, 3) m, at any heading."""
    extent_m = np.maximum(np.ptp(positions, axis=0), 1e-3)
    spread = np.array([1e-3, 1e-3, np.pi, *extent_m[:2], 1e-1 * extent_m[:2].max()])
    return PriorComponent(weight, np.diag(spread**2), is_anywhere=True)


class Tracker:
    """Places the scans of one drive among the active landmarks."""

    def __init__(self, calibration: Calibration, active: ActiveLandmarks, object_map: ObjectMap) -> None:
        self._config = calibration.objects
        self._detection = calibration.detection
        self.active = active
        self._map = object_map
        self._scans, self._slips = PRIOR_SCANS, 1
        self._failures = 0
        self._unmatched = 0  # detections since one was matched
        self._lost = deque[tuple[Tracked, OdometryPose]](maxlen=WAITED_SCANS)
        self._path = _Path(maxlen=RECENT_STEPS + 1)  # since the last restart
        self._T_odom_body = np.eye(4)  # where the odometry has the last pose of the path

    @property
    def is_tracking(self) -> bool:
        """Whether scans have been placed since the last restart, and landmarks are active."""
        return bool(self._path) and len(self.active.rows) > 1

    def restart(self) -> None:
        """Forget the motion and lost scans, as after a discontinuity of the odometry."""
        self._path.clear()
        self._lost.clear()

    def locate(self, scan: Scan, pose: OdometryPose) -> Tracked:
        """Place a scan of the body, which the odometry has at ``pose``, where the active landmarks are advanced to, and
        correct them and the pose by it.
        """
        tracked = self._track(scan, pose)
        # The noise of detections is that by the ranges of their landmarks.
        xyz_m, landmarks = self.active.T_local_body[:3, 3], tracked.assignment.landmark_rows
        ranges, known = np.linalg.norm(tracked.scan.positions, axis=1), landmarks >= 0
        ranges[known] = np.linalg.norm(self.active.positions[landmarks[known]] - xyz_m, axis=1)
        scan = with_expected_noise(tracked.scan, ranges, self._detection)
        tracked = self._updated(replace(tracked, scan=scan, seen=scan.seen_from(self.active.T_local_body)))
        if not tracked.is_lost:
            self._follow(pose.stamp_ns)
        return tracked

    def _track(self, scan: Scan, pose: OdometryPose) -> Tracked:
        """The scan at its pose, with the associations that are sure."""
        tracked = self._slipped(self._associated(scan))
        self._scans += 1
        is_failing = self._is_failing(tracked.assignment, tracked.seen.positions, self.active.T_local_body[:3, 3])
        self._failures = self._failures + 1 if is_failing else 0
        is_lost = is_failing
        is_ambiguous = tracked.assignment.is_contested and tracked.assignment.is_uncertain
        if len(self.active.rows) > 1 and (is_failing or is_ambiguous):
            gathered = self._gathered(tracked, pose, self._lost)
            search = self._search_of(gathered)
            if is_failing or search.is_pose_uncertain:
                modes = search.modes(self._components(pose, is_failing=is_failing))
                sure = self._sure_mode(gathered, modes)
                is_lost = is_failing and sure is None
                tracked = self._decided(tracked, modes, sure)
        if is_lost and self._failures <= WAITED_SCANS:
            rows = tracked.assignment.landmark_rows
            undecided = replace(tracked.assignment, landmark_rows=np.where(rows == NEW, AMBIGUOUS, rows))
            tracked = replace(tracked, assignment=undecided)
        tracked = replace(tracked, is_lost=is_lost)
        if is_lost:
            self._lost.append((tracked, pose))
        else:
            self._lost.clear()
        return tracked

    def rejoin(self, scan: Scan, pose: OdometryPose, untold: Sequence[tuple[Tracked, OdometryPose]]) -> Tracked:
        """The same for a ``pose`` after a step that no body can have made; lost where the detections do not tell.

        What was seen in the scans since that step, which are ``untold``, counts, too, as the odometry has it around the
        body now.
        """
        T_reported = self.active.T_local_odom @ pose.T_odom_body
        self.active.advance(self._expected(pose), is_guess=True)
        tracked = self._associated(scan)
        gathered = self._gathered(tracked, pose, untold)
        components = [
            PriorComponent(0.5 * JUMPED, self._slip(pose.stamp_ns)),
            PriorComponent(1.0 - JUMPED, np.zeros((6, 6)), T_reported @ invert(self.active.T_local_body)),
            _anywhere(self.active.positions, 0.5 * JUMPED),
        ]
        mode = self._sure_mode(gathered, self._search_of(gathered).modes(components))
        if mode is None:
            return replace(tracked, is_lost=True)
        moved = self._shifted(tracked, mode)
        T_odom = rigid(self.active.T_odom_body @ invert(pose.T_odom_body))
        assert moved.correction is not None
        self._lost.clear()
        moved = self._updated(replace(moved, correction=Correction(T_odom, moved.correction.variances)))
        self._follow(pose.stamp_ns)
        return moved

    def _gathered(
        self, tracked: Tracked, pose: OdometryPose, untold: Sequence[tuple[Tracked, OdometryPose]]
    ) -> Tracked:
        """A scan together with the objects seen in those before it that did not tell either."""
        for earlier, earlier_pose in reversed(untold):
            T_now_earlier = relative(pose.T_odom_body, earlier_pose.T_odom_body)
            scan = earlier.scan.seen_from(T_now_earlier)
            near = cdist(scan.positions, tracked.scan.positions) < self._config.spacing_m
            other = ~(near & (earlier.labels[:, None] == tracked.labels)).any(axis=1)
            tracked = replace(
                tracked,
                scan=tracked.scan.joined(scan.of(other)),
                labels=np.concatenate([tracked.labels, earlier.labels[other]]),
            )
        return replace(tracked, seen=tracked.scan.seen_from(self.active.T_local_body))

    def _expected(self, pose: OdometryPose) -> OdometryPose:
        """The pose if the body has gone on as before."""
        return replace(pose, T_odom_body=self._T_odom_body @ self._path.step_until(pose.stamp_ns))

    def _associated(self, scan: Scan) -> Tracked:
        """The scan with the assignment at the predicted pose."""
        labels = self._map.labels.indices(scan.labels)
        seen = scan.seen_from(self.active.T_local_body)
        assignment = self._assignment(seen, labels, *self.active.predict())
        return Tracked(scan, labels, seen, self.active.rows, assignment)

    def _assignment(self, seen: Scan, labels: IntArray, positions: FloatArray, covariances: FloatArray) -> Assignment:
        """Of detections to the active landmarks at ``positions`` (A, 3) m with ``covariances`` (A, 3, 3) m^2."""
        detected = _objects(seen, labels, self._detection)
        return associate(detected, positions, covariances, self._map.labels.beliefs(self.active.rows), self._config)

    def _slipped(self, tracked: Tracked) -> Tracked:
        """The scan with the assignment by an odometry that slipped, if the matches that it gains are likelier than not,
        although a slip is rare.
        """
        before = tracked.assignment
        if not (before.landmark_rows == AMBIGUOUS).any():
            return tracked
        found = self._assignment(tracked.seen, tracked.labels, *self.active.predict_slipped())
        log_odds = np.log(self._slips / (self._scans - self._slips))
        is_likelier = found.log_likelihood_ratio + log_odds > before.log_likelihood_ratio
        if not is_likelier or np.count_nonzero(found.matched) <= np.count_nonzero(before.matched):
            return tracked
        self.active.slip()
        return replace(tracked, assignment=found)

    def _search_of(self, tracked: Tracked) -> ModeSearch:
        seen = _objects(tracked.seen, tracked.labels, self._detection)
        return ModeSearch(seen, self.active.known_landmarks(), self.active.T_local_body[:3, 3], self._config)

    def _is_failing(self, assignment: Assignment, seen: FloatArray, origin: FloatArray) -> bool:
        """Whether the detections ``seen`` (D, 3) m from a body at ``origin`` (3,) m do not fit the landmarks: fewer are
        matched than should be, or the matches are too far apart. Those of earlier scans count as long as none matches.
        """
        if assignment.is_inconsistent:
            return True
        positions = self.active.positions
        matched = np.bincount(assignment.landmark_rows[assignment.matched], minlength=len(positions)) > 0
        count = int(matched.sum())
        unmatched = len(seen) - count
        self._unmatched = 0 if count else self._unmatched + unmatched
        seen_m = np.linalg.norm(seen - origin, axis=1)
        in_view = np.linalg.norm(positions - origin, axis=1) < seen_m.max(initial=0.0)
        return min(int((in_view & ~matched).sum()), max(unmatched, self._unmatched)) > max(count, 1)

    def _components(self, pose: OdometryPose, *, is_failing: bool) -> list[PriorComponent]:
        """The mixture of the prior; its wide parts where the odometry fails or has failed."""
        slips = self._slips / self._scans
        components = [PriorComponent(1.0 - slips, np.zeros((6, 6)))]
        if is_failing or self._slips > 1:
            step = _size(relative(self._T_odom_body, pose.T_odom_body))
            components.append(PriorComponent(slips, self._slip(pose.stamp_ns, step)))
        if is_failing and self._path:
            T_expected = self.active.T_local_odom @ self._expected(pose).T_odom_body
            T_motion = T_expected @ invert(self.active.T_local_body)
            components.append(PriorComponent(JUMP_PROBABILITY, self._slip(pose.stamp_ns), T_motion))
        # The wide search is repeated at ever longer intervals while it fails.
        if is_failing and self._failures > 1 and self._failures & (self._failures - 1) == 0:
            components.append(_anywhere(self.active.positions, JUMP_PROBABILITY))
        return components

    def _slip(self, stamp_ns: int, step: FloatArray | float = 0.0) -> FloatArray:
        """Covariance (6, 6) of an error as large as the motion since the last scan, or as a step (2,).

        Tilt and height err by a tenth of that.
        """
        turn, length = np.maximum(step, self._path.way_until(stamp_ns)) ** 2 + 1e-8
        return np.diag([0.01 * turn, 0.01 * turn, turn, length, length, 0.01 * length])

    def _decided(self, tracked: Tracked, modes: list[Mode], sure: Mode | None) -> Tracked:
        """The scan by the posterior of the pose, and by the mode that is ``sure``."""
        if sure is not None and sure.component.added.any():
            self._slips += 1
            self._failures = 0
            return self._shifted(tracked, sure)
        weights, best = probabilities(modes), modes[0]
        # A detection that another mode takes for another landmark waits for scans that decide.
        count = len(tracked.labels)
        pairs = np.array([mode.assignment.landmark_rows[:count] for mode in modes])
        agrees = ((pairs == pairs[0]) * weights[:, None]).sum(axis=0)
        contradicts = (((pairs != pairs[0]) & (pairs >= 0)) * weights[:, None]).sum(axis=0)
        is_sure = contradicts <= (1.0 - DECIDED) * (agrees + contradicts)
        # What it matches elsewhere than at the predicted pose would be taken for an error of the landmarks.
        is_elsewhere = bool(best.component.added.any())
        rows = np.where(is_sure & (not is_elsewhere), pairs[0], AMBIGUOUS)
        ratios = np.where(rows >= 0, best.assignment.log_likelihood_ratios[:count], 0.0)
        assignment = replace(tracked.assignment, landmark_rows=rows, log_likelihood_ratios=ratios)
        return replace(tracked, assignment=assignment)

    def _sure_mode(self, tracked: Tracked, modes: list[Mode]) -> Mode | None:
        """The likeliest mode, if its pose is sure and most detections or landmarks in view are matched at it."""
        best = modes[0]
        if not best.assignment.matched.any():
            return None
        same = np.array([bool(mode.assignment.matched.any()) and is_same_pose(mode, best) for mode in modes])
        turn_rad2 = np.linalg.eigvalsh(best.covariance[:3, :3])[-1]
        if probabilities(modes)[same].sum() < DECIDED or turn_rad2 > MAX_TURN_RAD**2:
            return None
        origin = apply(best.T_motion, self.active.T_local_body[:3, 3])
        positions = apply(best.T_motion, tracked.seen.positions)
        return None if self._is_failing(best.assignment, positions, origin) else best

    def _shifted(self, tracked: Tracked, mode: Mode) -> Tracked:
        """The scan at a pose that the odometry does not have."""
        before = self.active.T_local_body
        T_odom = self.active.shift(mode.T_motion, mode.component.added)
        shift = relative(before, self.active.T_local_body)
        shift_m2 = float(shift[:3, 3] @ shift[:3, 3]) / 3.0
        turn_rad2 = float(rotation_angle_rad(shift)) ** 2
        tilt, heading, position = np.diagonal(mode.covariance)[[0, 2, 3]]
        variances = np.array([position + shift_m2, tilt + turn_rad2, heading + turn_rad2])
        seen = tracked.scan.seen_from(self.active.T_local_body)
        assignment = mode.assignment.of(len(tracked.labels))
        return replace(tracked, seen=seen, assignment=assignment, correction=Correction(T_odom, variances))

    def _updated(self, tracked: Tracked) -> Tracked:
        """Correct the active landmarks and the pose among them by a scan, and the odometry if they show a slip."""
        known = tracked.landmark_rows >= 0
        rows, is_uncertain = tracked.landmark_rows[known], tracked.assignment.is_uncertain
        slip = self.active.update(rows, tracked.scan.of(known), is_uncertain=is_uncertain)
        return tracked if slip is None else replace(tracked, correction=slip)

    def _follow(self, stamp_ns: int) -> None:
        """Remember the pose, corrected by the landmarks."""
        self._path.append((stamp_ns, self.active.T_local_body))
        self._T_odom_body = self.active.T_odom_body
