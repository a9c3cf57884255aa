"""Detection of a kidnapping that the odometry does not show, from the landmarks around the robot.

If the robot was kidnapped at a time t, the landmarks from before are missed after it, and those seen after it were not
seen before, although the odometry had them around the robot. Each landmark contributes, for either side of t, one
log-likelihood ratio of "kidnapped at t" against "not kidnapped":

    log (1 - P_F u) / (1 - P_D u) if it was missed on that side,    log P_F / P_D if it was seen.

u is the probability that it was in view at all, from what the sensor saw so far at that range and bearing; P_D, also
estimated from the drive so far, that a landmark in view is seen; and P_F that another object is taken for it elsewhere.
The kidnapping is noticed once its posterior odds, with the rate of failures of the odometry as their prior, are high.
"""

from collections import deque

import numpy as np
from numpy.typing import NDArray
from scipy.special import expit, logit

from logs.records import frozen
from slam.common.arrays import BoolArray, FloatArray, IntArray
from slam.common.config import LocalizationConfig
from slam.common.geometry import apply, gravity_frame, invert, polar_cells
from slam.object_map.landmarks import LandmarkState, ObjectMap
from slam.odometry.keyframe import Keyframe
from slam.odometry.pose import OdometryPose

FALSE_MATCH_PROBABILITY = 0.1
"""P_F."""
PRIOR_SEEN, PRIOR_MISSED = 8.0, 2.0
"""Beta prior of P_D."""
RANGE_CELLS, BEARING_CELLS = 6, 8
PRIOR_EXPECTED = 2.0
"""Landmarks that are assumed not to have been seen in a cell: it may be hidden from the sensor as long as nothing was
seen there.
"""


@frozen
class _Step:
    """The pose of a keyframe, the landmarks seen since the one before it, and whether nothing was detected."""

    pose: OdometryPose
    T_gravity_local: FloatArray
    seen: IntArray
    is_blind: bool


class ContinuityMonitor:
    """The test at each keyframe, for every earlier time within two sensor ranges of travel on its segment."""

    def __init__(self, config: LocalizationConfig, sensor_range_m: float) -> None:
        self._memory_m = 2.0 * sensor_range_m
        self._log_prior = np.log(config.failure_probability(self._memory_m))
        self._least_llr = -logit(config.error_probability) - self._log_prior
        self.kidnapping_probability = 0.0
        """Posterior probability of the likeliest kidnapping at the last keyframe."""
        self._visibility = Visibility(sensor_range_m)
        self._counts = np.tile([PRIOR_SEEN, PRIOR_MISSED], (2, 1))
        self._steps: deque[_Step] = deque()

    def restart(self) -> None:
        """Forget the keyframes."""
        self._steps.clear()

    def update(self, keyframe: Keyframe, object_map: ObjectMap) -> float | None:
        """Add the newest keyframe; returns the travel [m] after which the robot was kidnapped, None if it was not."""
        pose, landmarks = keyframe.odometry, object_map.rows
        rows = np.flatnonzero(
            (landmarks["state"] == LandmarkState.CONFIRMED)
            & (landmarks["segment"] == pose.segment)
            & (landmarks["last_seen_travel_m"] > pose.travel_m - self._memory_m)
        )
        landmarks = landmarks[rows]
        if self._steps and self._steps[-1].pose.segment != pose.segment:
            self._steps.clear()
        self.kidnapping_probability = np.exp(self._log_prior)
        since_m = self._steps[-1].pose.travel_m if self._steps else -np.inf
        seen_since = rows[landmarks["last_seen_travel_m"] > since_m]
        T_gravity_local = invert(gravity_frame(keyframe.T_local_body))
        self._steps.append(_Step(pose, T_gravity_local, seen_since, object_map.detected_m <= since_m))
        while self._steps[-1].pose.travel_m - self._steps[0].pose.travel_m > self._memory_m:
            self._steps.popleft()
        # It happened after the last sighting of a landmark.
        times_m = np.unique(landmarks["last_seen_travel_m"])
        times_m = times_m[(times_m >= self._steps[0].pose.travel_m) & (times_m < self._steps[-1].pose.travel_m)]
        if not len(times_m):
            return None
        in_view, seen = self._sides(landmarks, times_m)
        llrs = self._log_likelihood_ratios(in_view, seen)
        self.kidnapping_probability = expit(llrs.max() + self._log_prior)
        missed = ((in_view[0] > 0.5) & (seen[0] == 0.0)).sum(axis=1)
        new = (landmarks["first_seen_travel_m"] > times_m[:, None]).sum(axis=1)
        # A sensor that goes blind misses landmarks, but sees nothing new.
        noticed = np.flatnonzero((llrs >= self._least_llr) & (np.minimum(missed, new) >= 2))
        if len(noticed):
            return float(times_m[noticed[np.argmax(llrs[noticed])]])
        if llrs.max() <= 0.0:  # else it might learn from the kidnapping that landmarks are missed
            self._learn(landmarks, rows, in_view, seen)
        return None

    def _sides(self, landmarks: NDArray[np.void], times_m: FloatArray) -> tuple[FloatArray, FloatArray]:
        """After and before each of S times, (2, S, N): the probability that a landmark, which is known from the other
        side, was in view, 0 if it is not; and whether it was seen.
        """
        T_gravity_local = np.array([step.T_gravity_local for step in self._steps])
        in_body = apply(T_gravity_local, landmarks["position_local"])  # (S, N, 3)
        shares = self._visibility.probability(in_body.reshape(-1, 3)).reshape(in_body.shape[:2])
        # Where nothing is detected at all, misses have one cause.
        shares[[step.is_blind for step in self._steps]] = 0.0
        log_missed = np.log1p(-np.minimum(shares, 0.99))
        sums = np.concatenate([np.zeros((1, len(landmarks))), np.cumsum(log_missed, axis=0)])
        # A keyframe stands for the sightings since the one before it; the one that a time falls between does not count.
        steps_before = np.searchsorted([step.pose.travel_m for step in self._steps], times_m, side="right")
        before = sums[steps_before]
        after = sums[-1] - sums[np.minimum(steps_before + 1, len(self._steps))]
        known_before = landmarks["first_seen_travel_m"] <= times_m[:, None]
        seen_after = landmarks["last_seen_travel_m"] > times_m[:, None]
        known = np.stack([known_before, seen_after])
        seen = np.stack([seen_after, known_before])
        return np.where(known, -np.expm1(np.stack([after, before])), 0.0), seen.astype(np.float64)

    def _log_likelihood_ratios(self, in_view: FloatArray, seen: FloatArray) -> FloatArray:
        """LLR (S,) of a kidnapping at each time; a sensor that misses as much as chance tells nothing."""
        detected = np.maximum(self._counts[:, 0] / self._counts.sum(axis=1), FALSE_MATCH_PROBABILITY)[:, None, None]
        of_seen = np.where(in_view > 0.0, np.log(FALSE_MATCH_PROBABILITY / detected), 0.0)
        of_missed = np.log1p(-FALSE_MATCH_PROBABILITY * in_view) - np.log1p(-detected * in_view)
        return np.where(seen > 0.0, of_seen, of_missed).sum(axis=(0, 2))

    def _learn(self, landmarks: NDArray[np.void], rows: IntArray, in_view: FloatArray, seen: FloatArray) -> None:
        """Region in which existing landmarks are observed, and the share of those in view that are observed."""
        middle = len(self._steps) // 2
        step = self._steps[middle]
        there = landmarks["first_seen_travel_m"] <= step.pose.travel_m
        there &= landmarks["last_seen_travel_m"] >= step.pose.travel_m
        self._visibility.learn(
            apply(step.T_gravity_local, landmarks["position_local"][there]),
            np.isin(rows[there], step.seen, assume_unique=True),
        )
        index = seen.shape[1] // 2
        in_view, seen = in_view[:, index], seen[:, index]
        # Each landmark is in the middle of the window for as many keyframes as the window has on one side of it.
        self._counts += np.stack([(in_view * seen).sum(axis=1), (in_view * (1.0 - seen)).sum(axis=1)], axis=1) / (
            middle + 1.0
        )


class Visibility:
    """Cells of range and bearing up to ``range_m``, and the share of the landmarks in each that were seen."""

    def __init__(self, range_m: float) -> None:
        self._range_m = range_m
        # The last cell is all that is out of range.
        self._expected = np.full(RANGE_CELLS * BEARING_CELLS + 1, PRIOR_EXPECTED)
        self._seen = np.zeros_like(self._expected)

    def learn(self, positions: FloatArray, seen: BoolArray) -> None:
        """Add landmarks at ``positions`` (N, 3) m in the frame of the upright body: which of them were seen (N,)."""
        cells = self._cells(positions)
        self._expected += np.bincount(cells, minlength=len(self._expected))
        self._seen += np.bincount(cells, seen, minlength=len(self._seen))
        self._seen[-1] = 0.0

    def probability(self, positions: FloatArray) -> FloatArray:
        """Probability (N,) that landmarks at ``positions`` (N, 3) m are seen; 0 out of range."""
        return (self._seen / self._expected)[self._cells(positions)]

    def _cells(self, positions: FloatArray) -> IntArray:
        ring, sector = polar_cells(positions, self._range_m, RANGE_CELLS, BEARING_CELLS)
        return np.minimum(ring * BEARING_CELLS + sector, RANGE_CELLS * BEARING_CELLS)
