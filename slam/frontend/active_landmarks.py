"""The landmarks around the robot that detections are associated with, and the robot among them.

All of them are in the EKF of :mod:`slam.frontend.local_map`; those that are confirmed correct the robot's pose.
"""

from dataclasses import replace

import numpy as np

from slam.common.arrays import BoolArray, FloatArray, IntArray, median
from slam.common.config import Config
from slam.common.geometry import covariance_in_axes, invert, make_transform, relative, rigid, rotation_of, view_change
from slam.frontend.data_association import squared_distances
from slam.frontend.input.scan import Scan
from slam.frontend.local_map import LocalMap
from slam.frontend.pose_posterior import KnownLandmarks, fit_of
from slam.object_map.landmarks import LandmarkState, ObjectMap
from slam.odometry.noise import SLIP_INFLATION, covariance_of, model_variances
from slam.odometry.noise_scale import GATE, NoiseScale
from slam.odometry.pose import OdometryPose
from slam.odometry.track import Correction

MAX_LANDMARKS = 200
"""Landmarks around the robot that are kept for association, confirmed and tentative ones each, the latest seen."""
ACTIVE_RADII = 2.0
"""Landmarks farther from the robot than so many ranges of the farthest detection share no view with what is seen."""
MOVING_ACCELERATION_RANGES = 0.1
"""How much a moving object may change its speed, in sensor ranges per square second: a car brakes harder at times."""
FIXING_LANDMARKS = 3
"""Landmarks that fix a pose in space."""
# Least time over which a moving object is given to change its speed: 10 Hz scans leave it none, its noise does.
MIN_SWERVE_S = 0.5


class ActiveLandmarks:
    """The landmarks of the object map that are active, and the pose of the robot relative to them."""

    def __init__(self, config: Config, object_map: ObjectMap) -> None:
        self._config = config
        self._map = object_map
        self._local = LocalMap()
        self._pose: OdometryPose | None = None
        self._noise = NoiseScale(_useless(config))
        self._variances = np.zeros(3)  # of heading, x and y by the odometry since the last correction
        self._has_slipped = False  # since then
        self._detections_innovation_ratio = 0.0  # by the median squared distance of detections from their landmarks
        self.pose_covariance: FloatArray | None = None
        """(6, 6) of the body's pose against the landmarks in view, axes of the body; None before three were seen."""

    @property
    def odometry_factors(self) -> FloatArray:
        """Factors (2,) on the variances of the odometry's translation and heading, by the landmarks seen lately."""
        return self._noise.factors

    @property
    def rows(self) -> IntArray:
        """Rows (A,) of the active landmarks in the object map."""
        return self._local.ids

    @property
    def positions(self) -> FloatArray:
        """(A, 3) m of the active landmarks, local frame."""
        return self._local.positions

    @property
    def T_local_body(self) -> FloatArray:
        """(4, 4) of the last pose that was advanced to."""
        return self._local.T_local_body

    @property
    def T_odom_body(self) -> FloatArray:
        """(4, 4), the same by the odometry, as ``shift`` corrected it."""
        assert self._pose is not None
        return self._pose.T_odom_body

    @property
    def T_local_odom(self) -> FloatArray:
        """(4, 4) by which the landmarks correct the odometry now."""
        return self.T_local_body @ invert(self.T_odom_body)

    def restart(self, pose: OdometryPose | None = None) -> None:
        """Restart at a pose, or where the body is, without landmarks."""
        self._pose = pose or self._pose
        self._variances, self._has_slipped = np.zeros(3), False
        self._local.start(self.T_odom_body)

    def advance(self, pose: OdometryPose, *, is_guess: bool = False) -> FloatArray:
        """Follow the odometry, or a guess, to a pose of the same segment; returns ``T_local_body`` (4, 4) there."""
        before = self._pose
        if before is None:
            self.restart(pose)
        elif pose.stamp_ns != before.stamp_ns:
            config = self._config.calibration.odometry
            of_translation, of_heading = self.odometry_factors
            factors = np.array([of_translation, SLIP_INFLATION**2, of_heading])
            variances = factors * model_variances(before, pose, config)
            covariance = covariance_of(variances, pose, of_translation * config.min_translation_sigma_m**2)
            T_before = self._local.T_local_body
            self._local.advance(relative(before.T_odom_body, pose.T_odom_body), covariance)
            self._variances += variances[[2, 0, 0]]
            self._pose = pose
            if not is_guess:
                # The error of each landmark changes with the view of it: detections of one view share their error,
                # which is part of where the landmark seems to be, and walks at random.
                views = (self.positions - T[:3, 3] for T in (T_before, self.T_local_body))
                of_views = view_change(*views)[:, None] * self._config.calibration.detection.view_variances
                self._local.move(np.arange(len(of_views)), np.zeros_like(of_views), of_views)
            self._move(before.stamp_ns, pose.stamp_ns)
        return self.T_local_body

    def at(self, pose: OdometryPose) -> FloatArray:
        """``T_local_body`` (4, 4) at a pose of the segment; landmarks are advanced to it if it is a later one."""
        if self._pose is not None and pose.stamp_ns < self._pose.stamp_ns:
            return self.T_local_odom @ pose.T_odom_body
        return self.advance(pose)

    def _move(self, before_ns: int, after_ns: int) -> None:
        """Let landmarks that seem to move go on moving."""
        landmarks = self._map.rows
        slots = np.flatnonzero(landmarks["velocity_local"][self.rows].any(axis=1))
        if not len(slots):
            return
        rows = self.rows[slots]
        shifts = landmarks["velocity_local"][rows] * (1e-9 * (after_ns - before_ns))
        # By so much moving objects leave the way that their velocity takes them.
        seconds = 1e-9 * (np.array([[before_ns], [after_ns]]) - landmarks["last_seen_ns"][rows])
        swerves_m = (
            MOVING_ACCELERATION_RANGES * self._config.sensor_range_m * seconds * np.maximum(seconds, MIN_SWERVE_S)
        )
        variances = np.maximum(np.diff(swerves_m**2, axis=0)[0], 0.0)
        self._local.move(slots, shifts, variances[:, None])

    def predict(self) -> tuple[FloatArray, FloatArray]:
        """Predicted positions (A, 3) m of the active landmarks, and covariances (A, 3, 3) m^2 relative to the robot."""
        return self._local.predict(np.arange(len(self.rows)))

    def predict_slipped(self) -> tuple[FloatArray, FloatArray]:
        """The same where the odometry since the last correction errs by SLIP_INFLATION times its noise."""
        positions, covariances = self.predict()
        effects = self._local.step_effects(np.arange(len(self.rows))).reshape(-1, 3, 3) * np.sqrt(self._slip_variances)
        return positions, covariances + effects @ effects.swapaxes(1, 2)

    def slip(self) -> None:
        """Let the odometry since the last correction err by as much."""
        heading, x, y = added = self._slip_variances
        self._local.shift(np.eye(4), np.diag([0.0, 0.0, heading, x, y, 0.0]))
        self._variances, self._has_slipped = self._variances + added, True

    @property
    def _slip_variances(self) -> FloatArray:
        """(3,) of heading, x and y, beyond those of the noise."""
        return (0.0 if self._has_slipped else SLIP_INFLATION**2 - 1.0) * self._variances

    def known_landmarks(self) -> KnownLandmarks:
        """The active landmarks with their joint covariance."""
        joint = self._local.relative_covariance(np.arange(len(self.rows)))
        return KnownLandmarks(self.positions, self._map.labels.beliefs(self.rows), joint)

    def shift(self, T_correction: FloatArray, covariance: FloatArray) -> FloatArray:
        """Correct the pose of the body by (4, 4) in the local frame, and add a covariance (6, 6) to its error, local
        axes; returns the same correction (4, 4) in the frame of the odometry, whose poses it corrects from now on.
        """
        T_odom = self._correct_odometry(T_correction)
        self._local.shift(T_correction, covariance)
        self._variances, self._has_slipped = np.zeros(3), False
        return T_odom

    def _correct_odometry(self, T_local: FloatArray) -> FloatArray:
        """Move where the odometry has the body by (4, 4) in the local frame; returns the same in the frame of the
        odometry.
        """
        assert self._pose is not None
        T_local_odom = self.T_local_odom
        T_odom = rigid(invert(T_local_odom) @ T_local @ T_local_odom)
        self._pose = replace(self._pose, T_odom_body=rigid(T_odom @ self._pose.T_odom_body))
        return T_odom

    def update(self, rows: IntArray, scan: Scan, *, is_uncertain: bool) -> Correction | None:
        """Correct landmarks and robot by detections of them; returns the correction of the odometry if it slipped.

        Args:
            rows: (K,) of active landmarks.
            scan: K detections, in the frame of the body.
            is_uncertain: the pose is less certain than the detections; then tentative landmarks correct it, too, where
                there are too few confirmed ones. They may be of moving objects.
        """
        landmarks, indices = self._map.rows[rows], self._local.slots(rows)
        seen = scan.seen_from(self.T_local_body)
        if len(rows):
            positions, covariances = self._local.predict(indices)
            distances, _ = squared_distances(seen.positions - positions, covariances + seen.covariances)
            self._detections_innovation_ratio = median(distances) / GATE
        corrects = landmarks["state"] == LandmarkState.CONFIRMED
        if is_uncertain and np.count_nonzero(corrects) < FIXING_LANDMARKS:
            corrects = (landmarks["state"] != LandmarkState.RETIRED) & ~landmarks["velocity_local"].any(axis=1)
        slip = self._correct(indices[corrects], seen.of(corrects))
        others = ~corrects
        seen = scan.seen_from(self.T_local_body)
        offsets = seen.positions[others] - self.T_local_body[:3, 3]
        self._local.update_landmarks(indices[others], offsets, seen.covariances[others])
        positions, covariances = self.predict()
        self._map.assign(self.rows, position_local=positions, covariance_local=covariances)
        return slip

    def _correct(self, slots: IntArray, seen: Scan) -> Correction | None:
        """Correct the state by landmarks, and learn from it how large the errors of the odometry are."""
        if not len(slots):
            return None
        sigmas = np.sqrt(self._variances)
        offsets, effects = seen.positions - self.T_local_body[:3, 3], self._local.step_effects(slots) * sigmas
        innovation, effects = self._local.update(slots, offsets, seen.covariances, seen.stamp_shifts, effects)
        error = sigmas * self._noise.slip(innovation, effects, has_slipped=self._has_slipped)
        if not self._has_slipped:
            self._noise.add(innovation, effects)
        self._variances, self._has_slipped = np.zeros(3), False
        T_local_body = self.T_local_body
        if len(slots) >= FIXING_LANDMARKS:
            fit = fit_of(self.positions[slots] - T_local_body[:3, 3])
            covariance = fit @ self._local.relative_covariance(slots) @ fit.T
            self.pose_covariance = covariance_in_axes(covariance, T_local_body[:3, :3])
        if not error.any():
            return None
        heading, x, y = error
        R, xyz_m = rotation_of(np.array([0.0, 0.0, heading])), T_local_body[:3, 3]
        T_odom = self._correct_odometry(make_transform(R, xyz_m + np.array([x, y, 0.0]) - R @ xyz_m))
        return Correction(T_odom, np.array([0.5 * (x**2 + y**2), 0.0, heading**2]))

    @property
    def innovation_ratios(self) -> dict[str, float]:
        """By source, the ratio of the last squared innovation to its variance and the gate: above 1 the others
        contradict the source.
        """
        return {"odometry": self._noise.innovation_ratio, "detections": self._detections_innovation_ratio}

    def add(self, rows: IntArray) -> None:
        """Make landmarks active; they are tentative until they are confirmed."""
        landmarks = self._map.rows[rows]
        self._local.insert(rows, landmarks["position_local"] - self.T_local_body[:3, 3], landmarks["covariance_local"])

    def drop(self, rows: IntArray) -> None:
        """Make landmarks inactive."""
        self._local.remove(rows)

    def surplus(self) -> BoolArray:
        """(A,) which landmarks are too far to be seen again soon, or too many to keep: the longest unseen ones."""
        landmarks, rows = self._map.rows, self.rows
        distances = np.linalg.norm(self.positions - self.T_local_body[:3, 3], axis=1)
        gone = distances > ACTIVE_RADII * self._config.calibration.detection.farthest_m
        confirmed = landmarks["state"][rows] == LandmarkState.CONFIRMED
        for members in (np.flatnonzero(confirmed & ~gone), np.flatnonzero(~confirmed & ~gone)):
            excess = len(members) - MAX_LANDMARKS
            if excess > 0:
                oldest = np.argsort(landmarks["last_seen_ns"][rows[members]], kind="stable")[:excess]
                gone[members[oldest]] = True
        return gone


def _useless(config: Config) -> FloatArray:
    """Factors (2,) on the variances of an odometry that errs by the sensor range, or half a turn, over that travel."""
    odometry, range_m = config.calibration.odometry, config.sensor_range_m
    sigmas = np.array([odometry.translation_sigma, odometry.yaw_sigma])
    return np.square([range_m, np.pi]) / (sigmas**2 * range_m)
