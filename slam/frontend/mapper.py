"""From odometry and detections to keyframes, landmarks and factors.

Each scan is associated with the landmarks around the robot (odometry frame); each keyframe hands what was seen since
the last one to the factor graph (map frame).
"""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray
from scipy.special import betaln

from logs.messages import DetectionAssociations
from slam.backend.factor_graph import FactorGraph
from slam.backend.factors import Edge, EdgeKind
from slam.common.arrays import BoolArray, IntArray
from slam.common.config import Config
from slam.common.geometry import relative
from slam.frontend.active_landmarks import ActiveLandmarks
from slam.frontend.data_association import AMBIGUOUS, DECIDED, NEW
from slam.frontend.input.scan import Scan
from slam.frontend.pending_observations import PendingObservations
from slam.frontend.tracker import Tracked, Tracker
from slam.object_map.landmarks import LandmarkState, ObjectMap, RetirementReason
from slam.odometry.keyframe import Keyframe, is_keyframe_due
from slam.odometry.noise import step_covariance
from slam.odometry.pose import OdometryPose

UPDATE_KEYFRAMES = 5
"""Keyframes between two updates of the graph; in between only the local map follows."""
CONFIRM_OBSERVATIONS = 4
"""Observations that confirm a landmark."""
CONFIRM_FRACTION, DETECTED_SHARE = 0.4, 0.5
"""Least share of the scans since its first observation in which it was observed, and of those in which an object is
detected: each of several sensors may miss it.
"""
MISSED_RANGES, MISSED_SCANS = 0.5, 20
"""A tentative landmark unseen for that travel in sensor ranges, or for more scans, retires."""
MOVING_RANGES_PER_S, MOVING_RANGES, MOVING_OBSERVATIONS = 1.0 / 30.0, 1.0 / 12.0, 5
"""An object moves if it is faster than that and has moved so far, both in sensor ranges, in so many observations; it is
confirmed once its speed and two standard deviations of it are below.
"""
# A speed is significant if it is that many of its standard deviations.
MOVING_SIGMAS = 3.0
BREAK_SIGMA_RAD = 1.0
BREAK_SIGMA_RANGES = 10 / 3
"""A discontinuity of the odometry holds no information, but the graph must stay connected until a closure joins it."""


class Mapper:
    """Builds the object map and the factor graph; ``keyframes`` are all keyframes so far."""

    def __init__(
        self, config: Config, object_map: ObjectMap, graph: FactorGraph, prior_keyframes: Sequence[Keyframe] = ()
    ) -> None:
        self._config = config
        objects = config.calibration.objects
        self._confirm_fraction = min(CONFIRM_FRACTION, DETECTED_SHARE * objects.detection_probability)
        self._max_missed_scans = MISSED_SCANS * objects.detection_period
        self._map = object_map
        self._graph = graph
        self._active = ActiveLandmarks(config, object_map)
        self.tracker = Tracker(config.calibration, self._active, object_map)
        self._pending = PendingObservations(config, object_map)
        self._message_count = 0
        self._sensors: set[str] = set()
        self._scan_count = 0  # several sensors share the view: a scan is counted when each has given one
        self.keyframes: list[Keyframe] = [*prior_keyframes]

    @property
    def segment(self) -> int | None:
        """Segment of the last keyframe; None before the first."""
        return self.keyframes[-1].odometry.segment if self.keyframes else None

    def add_odometry(self, pose: OdometryPose) -> Keyframe | None:
        """Follow the track to its newest pose; returns the keyframe if one was made there."""
        previous, continues = self.keyframes[-1] if self.keyframes else None, pose.segment == self.segment
        if previous and continues:
            T_local_body = self._active.T_local_odom @ pose.T_odom_body
            if not is_keyframe_due(previous, pose, T_local_body, self._config):
                return None
        if previous and not previous.is_prior:
            self.close_keyframe(ends_group=False)
        if previous and not continues:
            self._restart(pose)
        keyframe = Keyframe(len(self.keyframes), pose, self._active.at(pose))
        if previous:
            T_previous_keyframe = relative(previous.T_local_body, keyframe.T_local_body) if continues else None
            self._graph.add_next_keyframe(self._odometry_edge(previous, keyframe), T_previous_keyframe)
        else:
            self._graph.add_keyframe(keyframe.id, pose.T_odom_body)
        self.keyframes.append(keyframe)
        if keyframe.id % UPDATE_KEYFRAMES == 0:
            self._graph.update()
        return keyframe

    def locate(self, scan: Scan, pose: OdometryPose) -> Tracked:
        """Estimate the pose of a scan, predicted by ``pose``, among the landmarks, and associate its detections."""
        if len(scan.positions):
            self._map.detected_m = pose.travel_m
        self._active.advance(pose)
        self._deactivate_stale(pose.travel_m)
        return self.tracker.locate(scan, pose)

    def add_scan(self, tracked: Tracked, pose: OdometryPose) -> DetectionAssociations:
        """Bring the landmarks up to date by a scan, whose keyframe is the last one."""
        scan, labels, rows = tracked.scan, tracked.labels, tracked.landmark_rows
        self._message_count += 1
        self._sensors.add(scan.sensor)
        self._scan_count = self._message_count // len(self._sensors)
        in_keyframe = scan.seen_from(relative(self.keyframes[-1].T_local_body, self._active.T_local_body))
        # Keyframes since then may have made landmarks inactive.
        rows = np.where((rows[:, None] == self._active.rows).any(axis=1) | (rows == NEW), rows, AMBIGUOUS)
        known, new = rows >= 0, rows == NEW
        self._map.record_observations(
            rows[known],
            tracked.seen.positions[known],
            tracked.seen.covariances[known],
            labels[known],
            tracked.assignment.log_likelihood_ratios[known],
            stamp_ns=scan.stamp_ns,
            scan=self._scan_count,
            travel_m=pose.travel_m,
        )
        if new.any():
            corrected = scan.seen_from(self._active.T_local_body)
            rows[new] = self._map.add(
                corrected.positions[new],
                corrected.covariances[new],
                labels[new],
                stamp_ns=scan.stamp_ns,
                scan=self._scan_count,
                travel_m=pose.travel_m,
                segment=self.keyframes[-1].odometry.segment,
            )
            self._active.add(rows[new])
        used = rows >= 0
        self._pending.add(rows[used], in_keyframe.of(used))
        self._update_life_cycle(rows[used])
        # One entry for each detection of the message, used or not.
        rows_of_all, is_new = np.full(len(scan.used), NEW), np.zeros(len(scan.used), dtype=np.bool_)
        rows_of_all[scan.used], is_new[scan.used] = rows, new
        landmark_ids = tuple(str(row) if row >= 0 else "" for row in rows_of_all.tolist())
        return DetectionAssociations(scan.stamp_ns, landmark_ids, is_new)

    def retire_gone(self, rows: IntArray) -> None:
        """Retire landmarks that no longer exist; a landmark that others were merged into was observed again."""
        rows = rows[~np.isin(rows, list(self._map.aliases.values()))]
        self._retire(rows, RetirementReason.GONE)
        self._active.drop(rows)

    def break_at(self, first: Keyframe) -> None:
        """Let a new segment begin with a keyframe. Landmarks first observed on it so far are retired, as others that
        are wrongly taken to be around have moved them, and observations from its keyframes are removed.
        """
        landmarks = self._map.rows
        rows = np.flatnonzero(
            (landmarks["first_seen_ns"] >= first.odometry.stamp_ns)
            & (landmarks["segment"] == first.odometry.segment)
            & (landmarks["state"] != LandmarkState.RETIRED)
        )
        self._retire(rows, RetirementReason.CONTRADICTED)
        self._restart()
        self._pending = PendingObservations(self._config, self._map)
        for keyframe in self.keyframes[first.id :]:
            pose = replace(keyframe.odometry, segment=keyframe.odometry.segment + 1)
            self.keyframes[keyframe.id] = replace(keyframe, odometry=pose, T_local_body=pose.T_odom_body)
        self._graph.break_before(self._odometry_edge(*self.keyframes[first.id - 1 : first.id + 1]))

    def _odometry_edge(self, previous: Keyframe, keyframe: Keyframe) -> Edge:
        """The edge between successive keyframes; it holds next to nothing across a break."""
        before, after, kind = previous.odometry, keyframe.odometry, EdgeKind.ODOMETRY
        calibrated = self._config.calibration.odometry
        covariance = step_covariance(before, after, calibrated, self._active.odometry_factors)
        if after.segment != before.segment:
            kind = EdgeKind.DISCONTINUITY
            sigma_m = BREAK_SIGMA_RANGES * self._config.sensor_range_m
            covariance = np.diag(np.repeat([BREAK_SIGMA_RAD**2, sigma_m**2], 3))
        return Edge(previous.id, keyframe.id, relative(before.T_odom_body, after.T_odom_body), covariance, kind)

    def close_keyframe(self, *, ends_group: bool = True) -> None:
        """Add the observations since the last keyframe to the graph; those of tentative landmarks are held back."""
        self._graph.add_observations(self._pending.close(self.keyframes[-1], ends_group=ends_group))

    def _restart(self, pose: OdometryPose | None = None) -> None:
        """Restart the local map at a pose, or where the body is, without active landmarks."""
        self._deactivate(self._active.rows)
        self._active.restart(pose)
        self.tracker.restart()

    def _update_life_cycle(self, seen: IntArray) -> None:
        """Update the life cycle of the observed landmarks: confirm static ones, retire moving ones.

        What is faster than its noise explains is followed at its speed: a landmark that only seemed to move slows down
        again as observations accumulate, a vehicle goes far enough to be recognised.
        """
        range_m, landmarks = self._config.sensor_range_m, self._map.rows
        velocities_mps, noise_mps = self._map.velocities(seen)
        speeds = np.linalg.norm(velocities_mps, axis=1)
        too_fast = speeds > np.maximum(MOVING_RANGES_PER_S * range_m, MOVING_SIGMAS * noise_mps)
        observations, states = landmarks["observations"][seen], landmarks["state"][seen]
        seconds = (landmarks["last_seen_ns"][seen] - landmarks["first_seen_ns"][seen]) * 1e-9
        far = speeds * seconds > MOVING_RANGES * range_m
        exists = which_exist(landmarks, seen, self._scan_count)
        moving = too_fast & far & (observations >= MOVING_OBSERVATIONS) & exists
        followed = too_fast & (states != LandmarkState.CONFIRMED) & (observations >= 3)
        self._map.assign(seen, velocity_local=np.where((followed | moving)[:, None], velocities_mps, 0.0))
        stopped = (states == LandmarkState.RETIRED) & ~too_fast
        self._active.drop(seen[stopped])
        self._retire(seen[moving], RetirementReason.MOVING)  # still followed, it corrects nothing

        tentative = landmarks["state"][seen] == LandmarkState.TENTATIVE
        scans = self._scan_count - landmarks["first_scan"][seen] + 1
        steady = observations >= np.maximum(CONFIRM_OBSERVATIONS, self._confirm_fraction * scans)
        slow = np.maximum(speeds, 2.0 * noise_mps) <= MOVING_RANGES_PER_S * range_m
        self._map.confirm(seen[tentative & exists & steady & slow])

    def _deactivate_stale(self, travel_m: float) -> None:
        """Deactivate landmarks that were not observed for long; tentative and moving ones sooner."""
        landmarks, rows = self._map.rows, self._active.rows
        unseen_m = travel_m - landmarks["last_seen_travel_m"][rows]
        unseen_scans = self._scan_count - landmarks["last_scan"][rows]
        lost = (unseen_m > MISSED_RANGES * self._config.sensor_range_m) | (unseen_scans > self._max_missed_scans)
        stale = lost & (landmarks["state"][rows] != LandmarkState.CONFIRMED)
        self._deactivate(rows[stale | self._active.surplus()])

    def _deactivate(self, rows: IntArray) -> None:
        """Deactivate landmarks; tentative ones are retired."""
        tentative = self._map.rows["state"][rows] == LandmarkState.TENTATIVE
        self._retire(rows[tentative], RetirementReason.NOT_CONFIRMED)
        self._active.drop(rows)

    def _retire(self, rows: IntArray, reason: RetirementReason) -> None:
        """Retire landmarks and remove them from the graph."""
        if len(rows):
            self._graph.remove_landmarks(self._map.retire(rows, reason))


def which_exist(landmarks: NDArray[np.void], seen: IntArray, scan: int) -> BoolArray:
    """Which of the rows ``seen`` (N,) of the landmarks (L,) exist, and are not false detections that lie near each
    other by chance, by what was seen of them up to a scan; a single detection is no evidence against it.

    The log-odds that a landmark exists are

        log(prior odds) + log B(k + 1, n - k + 1)
            + sum over its k matches of log(p(z | landmark) / p(z | something else))

    after n scans since its first detection: each match is scored against the density of detections of no landmark, as
    in data association, and in how many of the scans it was found by the evidence of a detection probability that may
    be anything, with B the beta function. The prior is the share of the landmarks so far that were confirmed.
    (Integrated tracking: Musicki, Evans and Stankovic, IEEE Trans. Automatic Control, 1994; score of a track: Blackman
    and Popoli, Design and Analysis of Modern Tracking Systems, 1999, ch. 6.)
    """
    confirmed = np.count_nonzero(landmarks["state"] == LandmarkState.CONFIRMED)
    prior = np.log((confirmed + 1.0) / (len(landmarks) - confirmed + 1.0))
    matches = landmarks["observations"][seen] - 1
    missed = np.maximum(scan - landmarks["first_scan"][seen] - matches, 0)
    odds = prior + betaln(matches + 1.0, missed + 1.0) + landmarks["log_likelihood_ratio"][seen]
    return (matches == 0) | (odds >= np.log(DECIDED / (1.0 - DECIDED)))
