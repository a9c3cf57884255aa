"""The landmarks around the robot that detections are associated with, and the robot among them.

Confirmed landmarks are held by the EKF of :mod:`slam.frontend.local_map`, which corrects the robot's pose by them;
tentative ones have a small Kalman filter each and correct nothing. A confirmed landmark is let go when it is no longer
certain which of its like it is: when the standard deviation of its position relative to the robot, with the inflated
noise of the odometry, exceeds the distance between objects of its class; or when nothing that is seen here can be seen
from there, so that only the odometry relates the two. From then on its place has to be recognised, which is what loop
closing does.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.special import chdtri

from slam.common.arrays import BoolArray, FloatArray, IntArray
from slam.common.config import Config
from slam.frontend.data_association import GATE_PROBABILITY
from slam.frontend.input.scan import MIN_SIGMA_RANGES, Scan
from slam.frontend.landmark_filter import predict_covariances, update_positions
from slam.frontend.local_map import LocalMap, upright_step
from slam.object_map.landmarks import ObjectMap
from slam.odometry.noise import SLIP_INFLATION, step_variances
from slam.odometry.pose import OdometryPose

MAX_LANDMARKS = 200
"""Landmarks around the robot that are kept for association, the latest seen; their joint covariance takes 0.5 MB."""
ACTIVE_RADII = 2.0
"""Landmarks farther from the robot than so many ranges of the farthest detection share no view with what is seen."""
MOVING_ACCELERATION_RANGES = 0.1
"""How much a moving object may change its speed, in sensor ranges per square second: a car brakes harder at times."""
ODOMETRY_INFLATION, UNIQUE_INFLATION = SLIP_INFLATION, 5.0
"""Factor on the noise of the odometry, the second where objects are unique: a wide gate then confuses nothing."""
SAME_PROBABILITY = 0.99
"""Probability from which two landmarks are one object."""
# Least time over which a moving object is given to change its speed: 10 Hz scans leave it none, its noise does.
MIN_SWERVE_S = 0.5


@dataclass(frozen=True, slots=True, eq=False)
class Prediction:
    """Where landmarks should be seen: positions (A, 3) m, covariances (A, 3, 3) m^2 relative to the robot."""

    positions: FloatArray
    covariances: FloatArray


@dataclass(frozen=True, slots=True, eq=False)
class _Held:
    """The active landmarks in the EKF: their ``indices`` (K,) in ``rows``, their positions (K, 2) m, and covariances
    (K, 2, 2) m^2 relative to the robot.
    """

    indices: IntArray
    positions: FloatArray
    covariances: FloatArray


class ActiveLandmarks:
    """``rows`` (A,) of the object map that are active."""

    def __init__(self, config: Config, object_map: ObjectMap) -> None:
        self._config = config
        self._odometry_inflation = UNIQUE_INFLATION if config.calibration.has_unique_objects else ODOMETRY_INFLATION
        self._map = object_map
        self._local = LocalMap()
        self._pose: OdometryPose | None = None
        self._known_slots: tuple[IntArray, IntArray, IntArray] | None = None
        self._known_place: tuple[OdometryPose, FloatArray, FloatArray] | None = None
        self._known_held: tuple[IntArray, FloatArray, _Held] | None = None
        self.rows = np.zeros(0, dtype=np.int64)

    @property
    def T_local_body(self) -> FloatArray:
        """(4, 4) of the last pose that was advanced to."""
        assert self._pose is not None
        known, pose, local = self._known_place, self._pose, self._local.pose
        if known is None or known[0] is not pose or known[1] is not local:
            T_local_body = np.asarray(self._local.T_local_odom(pose.T_odom_body) @ pose.T_odom_body)
            self._known_place = known = pose, local, T_local_body
        return known[2]

    @property
    def T_local_odom(self) -> FloatArray:
        """(4, 4) by which the landmarks correct the odometry now."""
        assert self._pose is not None
        return self._local.T_local_odom(self._pose.T_odom_body)

    def restart(self, pose: OdometryPose) -> None:
        """Begin anew at a pose, without landmarks."""
        self._local.start(pose.T_odom_body)
        self._pose = pose
        self.rows = np.zeros(0, dtype=np.int64)

    def advance(self, pose: OdometryPose) -> FloatArray:
        """Follow the odometry to a pose of the same segment; returns ``T_local_body`` (4, 4) there."""
        before = self._pose
        if before is None:
            self.restart(pose)
        elif pose.stamp_ns != before.stamp_ns:
            variances = self._odometry_inflation**2 * step_variances(before, pose, self._config.calibration.odometry)
            self._local.advance(upright_step(before.T_odom_body, pose.T_odom_body), variances[::2])
            self._pose = pose
            rows = self.rows[self._slots < 0]
            landmarks = self._map.rows
            offsets = landmarks["position_local"][rows] - self.T_local_body[:3, 3]
            covariances = predict_covariances(landmarks["covariance_local"][rows], offsets, variances)
            self._map.assign(rows, covariance_local=covariances)
        return self.T_local_body

    def anchor(self) -> None:
        """Let covariances be relative to where the robot is now."""
        self._local.anchor()

    def predict(self, stamp_ns: int) -> Prediction:
        """Where the active landmarks should be at a time; those that seem to move go on moving."""
        landmarks, rows = self._map.rows, self.rows
        positions, covariances = landmarks["position_local"][rows], landmarks["covariance_local"][rows]
        velocities = landmarks["velocity_local"][rows]
        if velocities.any():
            seconds = (stamp_ns - landmarks["last_seen_ns"][rows]) * 1e-9
            acceleration = velocities.any(axis=1) * MOVING_ACCELERATION_RANGES * self._config.sensor_range_m
            swerve_m = acceleration * seconds * np.maximum(seconds, MIN_SWERVE_S)
            positions += seconds[:, None] * velocities
            covariances += (swerve_m**2)[:, None, None] * np.eye(3)
        held = self._held.indices
        if len(held) and self._pose is not None:
            travel_m = np.abs(self._pose.travel_m - landmarks["last_seen_travel_m"][rows[held]])
            heights = covariances[held, 2, 2] + self._config.calibration.odometry.translation_sigma**2 * travel_m
            positions[held, :2] = self._held.positions
            covariances[held] = 0.0
            covariances[held, :2, :2] = self._held.covariances
            covariances[held, 2, 2] = heights
        return Prediction(positions, covariances)

    def predict_from(self, pose: OdometryPose) -> tuple[FloatArray, Prediction]:
        """``T_local_body`` (4, 4) at a pose not yet moved to, and where active landmarks should be from there."""
        assert self._pose is not None
        T_local_body = np.asarray(self._local.T_local_odom(self._pose.T_odom_body) @ pose.T_odom_body)
        predicted = self.predict(pose.stamp_ns)
        variances = self._odometry_inflation**2 * step_variances(self._pose, pose, self._config.calibration.odometry)
        offsets = predicted.positions - T_local_body[:3, 3]
        return T_local_body, Prediction(
            predicted.positions, predict_covariances(predicted.covariances, offsets, variances)
        )

    def update(self, indices: IntArray, predicted: Prediction, seen: Scan, covariances: FloatArray) -> None:
        """Correct landmarks and robot by detections of them.

        Args:
            indices: (K,) into ``rows``.
            predicted: of all active landmarks.
            seen: K detections, local frame.
            covariances: (K, 3, 3) m^2 with which they correct the robot's pose and confirmed landmarks.
        """
        rows = self.rows[indices]
        positions, filtered = update_positions(
            predicted.positions[indices], predicted.covariances[indices], seen.positions, seen.covariances
        )
        slots = self._slots[indices]
        held = np.flatnonzero(slots >= 0)
        offsets = seen.positions[held, :2] - self.T_local_body[:2, 3]
        self._local.update(slots[held], offsets, covariances[held, :2, :2])
        self._map.assign(rows, position_local=positions, covariance_local=filtered)
        self._place_confirmed()
        if len(held):
            block = np.zeros((len(held), 3, 3))
            block[:, :2, :2] = self._local.predict(slots[held])[1]
            block[:, 2, 2] = filtered[held, 2, 2]
            self._map.assign(rows[held], covariance_local=block)

    def add(self, rows: IntArray) -> None:
        """Make landmarks active; they are tentative until they are confirmed."""
        if len(rows):
            self.rows = np.concatenate([self.rows, rows])

    def confirm(self, rows: IntArray) -> None:
        """Let confirmed landmarks (K,), active and in view, correct the robot's pose from now on.

        Of more than can be kept the others are made inactive at once: the filter's memory grows with their square.
        """
        most = MAX_LANDMARKS
        if len(rows) > most:
            self.drop(rows[:-most])
            rows = rows[-most:]
        if len(rows):
            landmarks = self._map.rows[rows]
            offsets = landmarks["position_local"][:, :2] - self.T_local_body[:2, 3]
            self._local.insert(rows, offsets, landmarks["covariance_local"][:, :2, :2])

    def drop(self, rows: IntArray) -> None:
        """Make landmarks inactive."""
        if len(rows):
            self.rows = self.rows[(self.rows[:, None] != rows).all(axis=1)]
            self._local.remove(rows)

    def release(self, rows: IntArray) -> None:
        """Let landmarks correct the robot's pose no longer, but go on following them."""
        self._local.remove(rows)

    def uncertain(self) -> BoolArray:
        """(A,) which confirmed landmarks may be confused with others of their class by now, or are too many to keep."""
        uncertain = np.zeros(len(self.rows), dtype=np.bool_)
        held, covariances = self._held.indices, self._held.covariances
        if len(held) == 0:
            return uncertain
        variances, covariance = np.diagonal(covariances, axis1=1, axis2=2), covariances[:, 0, 1]
        largest = 0.5 * variances.sum(axis=1) + np.hypot(0.5 * (variances[:, 0] - variances[:, 1]), covariance)
        distances = np.linalg.norm(self._held.positions - self.T_local_body[:2, 3], axis=1)
        uncertain[held] = (np.sqrt(largest) > self._config.calibration.objects.spacing_m) | (
            distances > ACTIVE_RADII * self._config.calibration.detection.farthest_m
        )
        excess = len(held) - MAX_LANDMARKS
        if excess > 0:
            oldest = np.argsort(self._map.rows["last_seen_ns"][self.rows[held]], kind="stable")[:excess]
            uncertain[held[oldest]] = True
        return uncertain

    def _place_confirmed(self) -> None:
        """Put the confirmed landmarks where the local map has them; their heights stay."""
        positions = self._map.rows["position_local"][self._local.ids]
        positions[:, :2] = self._local.positions()
        self._map.assign(self._local.ids, position_local=positions)

    def merge_duplicates(self) -> list[tuple[int, int]]:
        """Merge confirmed landmarks that are one object; returns rows (kept, dropped).

        Two are one if that is ``SAME_PROBABILITY`` likely: by the density at zero of their difference against the
        density at which objects of the class stand around.
        """
        merged = []
        while (pair := self._duplicate()) is not None:
            kept, dropped = pair
            self._local.merge(kept, dropped, self._view_variance)
            self.rows = self.rows[self.rows != dropped]
            self._place_confirmed()
            merged.append(pair)
        return merged

    def _duplicate(self) -> tuple[int, int] | None:
        """The likeliest pair of landmarks that are one, the older one first."""
        ids = self._local.ids
        if len(ids) < 2:
            return None
        classes, scans = self._map.classes(ids), self._map.rows["last_scan"][ids]
        # Two that were seen in one scan are two.
        first, second = np.nonzero(np.triu((classes[:, None] == classes) & (scans[:, None] != scans), 1))
        positions = self._local.positions()
        # Whatever their correlation is, the variance of a difference is at most twice the sum of both.
        offsets, variances = positions[first] - positions[second], self._local.variances()
        largest = 2.0 * (variances[first] + variances[second] + self._view_variance)
        near = np.einsum("ki,ki->k", offsets, offsets) < 14.0 * largest
        first, second = first[near], second[near]
        if len(first) == 0:
            return None
        difference, covariances = self._local.difference(first, second)
        covariances = covariances + self._view_variance * np.eye(2)
        near = np.einsum("ki,ki->k", difference, difference) < 14.0 * np.trace(covariances, axis1=1, axis2=2)
        first, second, difference, covariances = first[near], second[near], difference[near], covariances[near]
        if len(first) == 0:
            return None
        distances = np.einsum("ki,ki->k", difference, np.linalg.solve(covariances, difference[..., None])[..., 0])
        area = float(np.prod(np.maximum(np.ptp(positions, axis=0), 1e-3)))
        clutter = np.bincount(classes)[classes[first]] / area
        llr = -0.5 * (distances + np.log(np.linalg.det(2.0 * np.pi * covariances))) - np.log(clutter)
        llr[distances > float(chdtri(2, 1.0 - GATE_PROBABILITY))] = -np.inf
        best = int(np.argmax(llr))
        if llr[best] < np.log(SAME_PROBABILITY / (1.0 - SAME_PROBABILITY)):
            return None
        kept, dropped = sorted((int(ids[first[best]]), int(ids[second[best]])))
        return kept, dropped

    @property
    def _view_variance(self) -> float:
        """By how much [m^2] two views of an object differ in where they put it."""
        return (
            2.0
            * max(self._config.calibration.detection.common_sigma_m, MIN_SIGMA_RANGES * self._config.sensor_range_m)
            ** 2
        )

    @property
    def _held(self) -> _Held:
        """The active landmarks in the EKF as they are now."""
        known, slots, pose = self._known_held, self._slots, self._local.pose
        if known is None or known[0] is not slots or known[1] is not pose:
            indices = np.flatnonzero(slots >= 0)
            self._known_held = known = slots, pose, _Held(indices, *self._local.predict(slots[indices]))
        return known[2]

    @property
    def _slots(self) -> IntArray:
        """(A,) of the active landmarks in the EKF; -1 for those that it does not hold."""
        known, ids = self._known_slots, self._local.ids
        if known is None or known[0] is not self.rows or known[1] is not ids:
            self._known_slots = known = self.rows, ids, self._local.slots(self.rows)
        return known[2]
