"""Observations on their way from the scans into the factor graph."""

from collections import Counter, defaultdict
from collections.abc import Sequence

import numpy as np

from slam.backend.factors import Observation, stacked, sum_observations
from slam.common.arrays import FloatArray, IntArray
from slam.common.calibration import OdometryCalibration
from slam.common.config import Config
from slam.common.geometry import apply_each, relative
from slam.frontend.input.scan import Scan
from slam.object_map.landmarks import LandmarkState, ObjectMap
from slam.odometry.keyframe import Keyframe
from slam.odometry.noise import step_variances

GROUP_KEYFRAMES = 4
"""Consecutive keyframes that observe a landmark once, where the odometry between them is far better than a detection.
"""
MAX_MEASUREMENTS = 20
"""More measurements of a landmark from one keyframe, as of a robot that waits, share their errors and are left out."""
MAX_ADDED_VARIANCE = 0.1
"""The motion between keyframes of a group adds at most that share to the variance of an observation, in the mean."""


class PendingObservations:
    """Observations since the last keyframe, from the keyframes since the last group, and of tentative landmarks."""

    def __init__(self, config: Config, object_map: ObjectMap) -> None:
        self._detection = config.calibration.detection
        self._map = object_map
        self._scans: list[tuple[IntArray, Scan]] = []  # since the last keyframe, with the rows of their landmarks
        self._counts = Counter[int]()
        self._group = ObservationGroup(config.calibration.odometry)
        self._held_back: defaultdict[int, list[Observation]] = defaultdict(list)

    def add(self, rows: IntArray, scan: Scan) -> None:
        """Add what a scan, given in the frame of the last keyframe, saw of the landmarks ``rows`` (N,), none twice."""
        is_used = np.array([self._counts[row] < MAX_MEASUREMENTS for row in rows.tolist()], dtype=np.bool_)
        self._counts.update(rows[is_used].tolist())
        self._scans.append((rows[is_used], scan.of(is_used)))

    def close(self, keyframe: Keyframe, *, ends_group: bool) -> list[Observation]:
        """The observations for the graph once a keyframe has all of them; those of tentative landmarks wait."""
        ended = self._group.take() if self._group.ends_before(keyframe) else []
        self._group.add(keyframe, self._of_keyframe(keyframe.id))
        if ends_group or keyframe.id % GROUP_KEYFRAMES == 0:
            ended += self._group.take()
        for observation in ended:
            self._held_back[observation.landmark].append(observation)
        ready = []
        rows = sorted(self._held_back)
        for row, state in zip(rows, self._map.rows["state"][rows].tolist(), strict=True):
            if state == LandmarkState.CONFIRMED:
                ready += self._held_back.pop(row)
            elif state == LandmarkState.RETIRED:
                del self._held_back[row]
        return ready

    def _of_keyframe(self, keyframe: int) -> list[Observation]:
        """One observation a landmark, by the information of its measurements since the last keyframe.

        Where messages have no covariance, the correlation of their errors is unknown: then the error that all share is
        added, which no average reduces, and the inflation applies. It would multiply the noise of stamps, too, which
        differs from scan to scan, so that is left out.
        """
        scans, self._scans, self._counts = self._scans, [], Counter()
        if not scans:
            return []
        rows = np.concatenate([each for each, _ in scans])
        own = np.concatenate([scan.has_own_covariance for _, scan in scans])
        found = sum_observations(
            np.full(len(rows), keyframe),
            rows,
            np.concatenate([scan.positions for _, scan in scans]),
            np.concatenate([scan.own_covariances for _, scan in scans]),
            np.ones(len(rows)),
        )
        guessed, observations = set(rows[~own].tolist()), []
        for each in found:
            covariance, inflation = each.covariance_inflation * each.covariance, 1.0
            if each.landmark in guessed:
                covariance = covariance + self._detection.common_sigma_m**2 * np.eye(3)
                inflation = self._detection.covariance_inflation
            observations.append(Observation(each.keyframe, each.landmark, each.position, covariance, inflation))
        return observations


class ObservationGroup:
    """The observations of successive keyframes of one segment, which are handed out in the frame of the last one, one
    observation a landmark.

    The graph and its solvers take time and memory by the observation. While the odometry is far better than a
    detection, observations are transformed to the frame of a later keyframe without loss, by the landmarks around,
    because an error of the odometry would be common to all objects in view and not average out over them.
    """

    def __init__(self, config: OdometryCalibration) -> None:
        self._config = config
        self._keyframes: list[Keyframe] = []
        self._observations: list[Observation] = []
        self._variances = np.zeros(2)  # of the motion since the first keyframe: m^2 along an axis, rad^2 of the heading

    def add(self, keyframe: Keyframe, observations: Sequence[Observation]) -> None:
        """Add the observations from the next keyframe."""
        if self._keyframes:
            self._variances += self._step(keyframe)
        self._keyframes.append(keyframe)
        self._observations += observations

    def ends_before(self, keyframe: Keyframe) -> bool:
        """Whether a keyframe is of another segment, or the motion to it adds too much to the variances so far."""
        if not self._keyframes:
            return False
        if keyframe.odometry.segment != self._keyframes[-1].odometry.segment:
            return True
        if not self._observations:
            return False
        translation, heading = self._variances + self._step(keyframe)
        _, _, positions, covariances, inflations = stacked(self._observations)
        variances = np.trace(inflations[:, None, None] * covariances, axis1=1, axis2=2) / 3.0
        added = (translation + heading * np.linalg.norm(positions, axis=1) ** 2) / variances
        return bool(added.mean() > MAX_ADDED_VARIANCE)

    def take(self) -> list[Observation]:
        """The observations of the group, one a landmark, in the frame of the last keyframe; the next group begins."""
        keyframes, observations = self._keyframes, self._observations
        self._keyframes, self._observations, self._variances = [], [], np.zeros(2)
        if len(keyframes) < 2 or not observations:
            return observations
        first, last = keyframes[0], keyframes[-1]
        seen_from, landmarks, positions, covariances, inflations = stacked(observations)
        T = np.array([relative(last.T_local_body, each.T_local_body) for each in keyframes])[seen_from - first.id]
        R = T[:, :3, :3]
        return sum_observations(
            np.full(len(observations), last.id),
            landmarks,
            apply_each(T, positions),
            R @ (inflations[:, None, None] * covariances) @ np.swapaxes(R, 1, 2),
            inflations,
        )

    def _step(self, keyframe: Keyframe) -> FloatArray:
        return step_variances(self._keyframes[-1].odometry, keyframe.odometry, self._config)[[0, 2]]
