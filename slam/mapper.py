"""From odometry and detections to keyframes, landmarks and factors.

Each scan is associated with the landmarks around the robot (odometry frame); each keyframe hands what was seen since the
last one to the factor graph (map frame).
"""

from __future__ import annotations

from collections import defaultdict
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from logs.messages import DetectionAssociations
from slam.association import associate
from slam.config import Config
from slam.factor_graph import Edge, FactorGraph, Observation
from slam.geometry import FloatArray, IntArray, apply, rotation_angle_rad
from slam.landmark_filter import predict_covariances, update_positions
from slam.object_map import LandmarkState, ObjectMap, RetirementReason
from slam.odometry_track import OdometryPose, relative, step_covariance
from slam.scan import Scan
from slam.sightings import Sightings

# A break in the odometry ties nothing together, but the graph must stay connected until a closure does it.
BREAK_SIGMA_RAD = np.pi
BREAK_SIGMA_M = 1e3


@dataclass(frozen=True, slots=True, eq=False)
class Keyframe:
    """A pose of the track that the graph knows."""

    id: int
    odometry: OdometryPose


class Mapper:
    """Builds the object map and the factor graph; ``keyframes`` are all keyframes so far."""

    def __init__(self, config: Config, object_map: ObjectMap, graph: FactorGraph) -> None:
        self._config = config
        self._map = object_map
        self._graph = graph
        self._active = np.zeros(0, dtype=np.int64)
        self._sightings = Sightings()
        self._held_back: defaultdict[int, list[Observation]] = defaultdict(list)
        self._scan_count = 0
        self.keyframes: list[Keyframe] = []

    def add_odometry(self, pose: OdometryPose) -> Keyframe | None:
        """Follow the track to its newest pose; returns the keyframe if one was made there."""
        if self.keyframes and not self._keyframe_due(pose):
            return None
        keyframe = Keyframe(len(self.keyframes), pose)
        if not self.keyframes:
            self._graph.add_first_keyframe(keyframe.id, pose.T_odom_body)
        else:
            self.close_keyframe()
            self._graph.add_next_keyframe(self._odometry_edge(self.keyframes[-1], keyframe))
            if pose.segment != self.keyframes[-1].odometry.segment:
                self._active = self._active[:0]
        self.keyframes.append(keyframe)
        if keyframe.id % self._config.factor_graph.update_keyframes == 0:
            self._graph.update()
        return keyframe

    def add_scan(self, scan: Scan, pose: OdometryPose) -> DetectionAssociations:
        """Associate one scan, taken at ``pose``, with the landmarks around, and bring them up to date."""
        self._scan_count += 1
        positions = apply(pose.T_odom_body, scan.positions)
        R = pose.T_odom_body[:3, :3]
        covariances = R @ scan.covariances @ R.T
        labels = self._map.label_indices(scan.labels)
        self._forget(pose.travel_m)
        rows = self._associate(positions, covariances, labels, scan, pose)
        known = rows >= 0
        self._update(rows[known], positions[known], covariances[known], labels[known], scan, pose)
        rows[~known] = self._map.add(
            positions[~known],
            covariances[~known],
            labels[~known],
            stamp_ns=scan.stamp_ns,
            scan=self._scan_count,
            travel_m=pose.travel_m,
        )
        self._active = np.concatenate([self._active, rows[~known]])
        T_keyframe_body = relative(self.keyframes[-1].odometry.T_odom_body, pose.T_odom_body)
        R = T_keyframe_body[:3, :3]
        self._sightings.add(
            rows,
            apply(T_keyframe_body, scan.positions),
            R @ scan.covariances @ R.T,
            have_own_covariances=scan.has_own_covariances,
        )
        self._age(rows[known])
        return _associations(scan, rows, ~known)

    def close_keyframe(self) -> None:
        """Hand what was seen since the last keyframe to the graph; tentative landmarks are held back until confirmed."""
        observations = self._sightings.observations(self.keyframes[-1].id, self._config.detection)
        self._sightings = Sightings()
        states = self._map.rows["state"]
        for observation in observations:
            self._held_back[observation.landmark].append(observation)
        for row in sorted(self._held_back):
            if states[row] == LandmarkState.CONFIRMED:
                self._graph.add_observations(self._held_back.pop(row))
            elif states[row] == LandmarkState.RETIRED:
                del self._held_back[row]

    def _keyframe_due(self, pose: OdometryPose) -> bool:
        last = self.keyframes[-1].odometry
        limits = self._config.keyframe
        return bool(
            pose.segment != last.segment
            or pose.travel_m - last.travel_m >= limits.distance_m
            or pose.stamp_ns - last.stamp_ns >= limits.interval_s * 1e9
            or rotation_angle_rad(relative(last.T_odom_body, pose.T_odom_body)) >= np.deg2rad(limits.angle_deg)
        )

    def _odometry_edge(self, previous: Keyframe, keyframe: Keyframe) -> Edge:
        T_previous_keyframe = relative(previous.odometry.T_odom_body, keyframe.odometry.T_odom_body)
        travel_m = keyframe.odometry.travel_m - previous.odometry.travel_m
        covariance = step_covariance(T_previous_keyframe, travel_m, self._config.odometry)
        if keyframe.odometry.segment != previous.odometry.segment:
            covariance = np.diag(np.repeat([BREAK_SIGMA_RAD**2, BREAK_SIGMA_M**2], 3))
        return Edge(previous.id, keyframe.id, T_previous_keyframe, covariance, "odometry")

    def _associate(
        self, positions: FloatArray, covariances: FloatArray, labels: IntArray, scan: Scan, pose: OdometryPose
    ) -> IntArray:
        """The row (N,) of each detection's landmark, -1 for none."""
        if len(self._active) == 0:
            return np.full(len(positions), -1, dtype=np.int64)
        landmarks = self._map.rows[self._active]
        offsets = landmarks["position_odom"] - pose.T_odom_body[:3, 3]
        travel_since = pose.travel_m - landmarks["last_seen_travel_m"]
        predicted = predict_covariances(landmarks["covariance_odom"], offsets, travel_since, self._config.odometry)
        if not scan.has_own_covariances:
            predicted += self._config.detection.common_sigma_m**2 * np.eye(3)
        beliefs = self._map.beliefs(self._active)
        assignment = associate(
            positions, covariances, labels, landmarks["position_odom"], predicted, beliefs, self._config.association
        )
        return np.where(assignment.matched, self._active[assignment.landmark_rows], -1)

    def _update(
        self,
        rows: IntArray,
        positions: FloatArray,
        covariances: FloatArray,
        labels: IntArray,
        scan: Scan,
        pose: OdometryPose,
    ) -> None:
        """Move the landmarks ``rows`` (N,) to where they are now seen, and count the sightings."""
        landmarks = self._map.rows
        offsets = landmarks["position_odom"][rows] - pose.T_odom_body[:3, 3]
        travel_since = pose.travel_m - landmarks["last_seen_travel_m"][rows]
        predicted = predict_covariances(
            landmarks["covariance_odom"][rows], offsets, travel_since, self._config.odometry
        )
        fused, fused_covariances = update_positions(landmarks["position_odom"][rows], predicted, positions, covariances)
        landmarks["position_odom"][rows] = fused
        landmarks["covariance_odom"][rows] = fused_covariances
        self._map.record_sightings(
            rows, positions, labels, stamp_ns=scan.stamp_ns, scan=self._scan_count, travel_m=pose.travel_m
        )

    def _age(self, seen: IntArray) -> None:
        """Confirm what was seen often enough, retire what moves and what was seen too seldom."""
        limits = self._config.landmark
        landmarks = self._map.rows
        speeds = np.linalg.norm(self._map.velocities(seen), axis=1)
        too_fast = speeds > limits.moving_speed_mps + 2.0 * self._map.speed_sigmas(
            seen, self._config.detection.base_sigma_m
        )
        seconds = (landmarks["last_seen_ns"][seen] - landmarks["first_seen_ns"][seen]) * 1e-9
        moving = too_fast & (speeds * seconds > limits.moving_distance_m)
        self._retire(seen[moving], RetirementReason.MOVING)

        tentative = landmarks["state"][seen] == LandmarkState.TENTATIVE
        enough = landmarks["observations"][seen] >= limits.confirm_observations
        scans = self._scan_count - landmarks["first_scan"][seen] + 1
        steady = landmarks["observations"][seen] >= limits.confirm_fraction * scans
        self._map.confirm(seen[tentative & enough & steady & ~too_fast])

    def _forget(self, travel_m: float) -> None:
        """Let go of landmarks that were not seen for long; tentative ones end there."""
        limits = self._config.landmark
        landmarks = self._map.rows[self._active]
        unseen_m = travel_m - landmarks["last_seen_travel_m"]
        unseen_scans = self._scan_count - landmarks["last_scan"]
        tentative = landmarks["state"] == LandmarkState.TENTATIVE
        given_up = tentative & ((unseen_m > limits.give_up_distance_m) | (unseen_scans > limits.give_up_scans))
        ended = self._active[given_up]
        self._active = self._active[unseen_m <= self._config.association.forget_distance_m]
        self._retire(ended, RetirementReason.NOT_CONFIRMED)

    def _retire(self, rows: IntArray, reason: RetirementReason) -> None:
        if len(rows) == 0:
            return
        self._map.retire(rows, reason)
        self._active = self._active[~np.isin(self._active, rows)]
        for row in rows.tolist():
            self._held_back.pop(row, None)
            self._graph.remove_landmark(row)


def _associations(scan: Scan, rows: IntArray, created: NDArray[np.bool_]) -> DetectionAssociations:
    """One entry for each detection of the message, used or not."""
    landmark_ids = [""] * len(scan.used)
    created_of_all = np.zeros(len(scan.used), dtype=np.bool_)
    created_of_all[scan.used] = created
    for place, row in zip(np.flatnonzero(scan.used), rows, strict=True):
        landmark_ids[place] = str(row)
    return DetectionAssociations(scan.stamp_ns, tuple(landmark_ids), created_of_all)
