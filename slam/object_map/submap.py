"""Submaps: the landmarks around a pose from one traversal.

A submap lives in the odometry frame or in the gravity frame of a keyframe, never in the optimised map: over its few
tens of metres the odometry is smooth, and what closes loops must not depend on the loops closed before.
"""

from dataclasses import replace

import numpy as np

from logs.records import frozen
from slam.common.arrays import BoolArray, FloatArray, IntArray
from slam.common.calibration import Calibration
from slam.common.config import SUBMAP_RANGES
from slam.common.geometry import apply, gravity_frame, invert
from slam.object_map.landmarks import LandmarkState, ObjectMap
from slam.odometry.keyframe import Keyframe


@frozen
class Submap:
    """N landmarks. ``positions`` (N, 3) m, ``sigmas`` (N,) m of each horizontal coordinate, ``labels`` (N,) classes,
    ``rows`` (N,) of the object map; ``existence`` (N,) or one for all: probability that they are static objects;
    ``local_sigma_m``: of a coordinate relative to the landmarks beside it, as errors that grow with the travel are
    common to these. None: errors are independent.
    """

    positions: FloatArray
    sigmas: FloatArray
    labels: IntArray
    rows: IntArray
    existence: FloatArray | float = 1.0
    local_sigma_m: float | None = None

    def __len__(self) -> int:
        return len(self.rows)

    def of(self, chosen: BoolArray) -> "Submap":
        """Some of the landmarks, by a mask (N,), where all of them exist."""
        return replace(
            self,
            positions=self.positions[chosen],
            sigmas=self.sigmas[chosen],
            labels=self.labels[chosen],
            rows=self.rows[chosen],
        )


def recent_submap(object_map: ObjectMap, keyframe: Keyframe, calibration: Calibration) -> Submap:
    """The confirmed landmarks of the last stretch of travel, in the gravity frame of a keyframe (the paper's QLSM)."""
    return _recent(object_map, keyframe, calibration, object_map.rows["state"] == LandmarkState.CONFIRMED)


def recent_submap_with_unconfirmed(object_map: ObjectMap, keyframe: Keyframe, calibration: Calibration) -> Submap:
    """The same with the landmarks that were seen twice at least, but are not confirmed.

    Each exists with the share of the landmarks of its segment, seen as often, that were confirmed (the rule of
    succession, with one of either kind seen before).
    """
    landmarks = object_map.rows
    may_exist = (landmarks["state"] != LandmarkState.RETIRED) | object_map.never_confirmed
    found = _recent(object_map, keyframe, calibration, may_exist & (landmarks["observations"] >= 2))
    decided = (landmarks["segment"] == keyframe.odometry.segment) & (landmarks["state"] != LandmarkState.TENTATIVE)
    as_often = landmarks["observations"][decided] >= landmarks["observations"][found.rows][:, None]
    is_confirmed = landmarks["state"][decided] == LandmarkState.CONFIRMED
    shares = (1.0 + np.sum(as_often & is_confirmed, axis=1)) / (2.0 + np.sum(as_often, axis=1))
    existence = np.where(landmarks["state"][found.rows] == LandmarkState.CONFIRMED, 1.0, shares)
    return replace(found, existence=existence)


def _recent(object_map: ObjectMap, keyframe: Keyframe, calibration: Calibration, chosen: BoolArray) -> Submap:
    """Of the ``chosen`` landmarks (L,) those of the last stretch of travel, in the gravity frame of a keyframe."""
    landmarks, pose = object_map.rows, keyframe.odometry
    recent = landmarks["last_seen_travel_m"] > pose.travel_m - SUBMAP_RANGES * calibration.detection.sensor_range_m
    rows = np.flatnonzero(chosen & recent & (landmarks["segment"] == pose.segment))
    positions = apply(invert(gravity_frame(keyframe.T_local_body)), landmarks["position_local"][rows])
    return make_submap(object_map, rows, positions, np.zeros(3), calibration)


def make_submap(
    object_map: ObjectMap, rows: IntArray, positions: FloatArray, centre: FloatArray, calibration: Calibration
) -> Submap:
    """The landmarks ``rows`` (N,) at ``positions`` (N, 3) m of a frame, from a traversal near ``centre`` (3,) in it."""
    distances = np.hypot(*(positions - centre)[:, :2].T)
    own_variances = np.trace(object_map.rows["covariance_local"][rows][:, :2, :2], axis1=1, axis2=2) / 2.0
    objects = calibration.objects
    variances = objects.landmark_sigma_m**2 + (objects.landmark_sigma_per_m * distances) ** 2 + own_variances
    classes = object_map.labels.classes(rows)
    return Submap(positions, np.sqrt(variances), classes, rows, local_sigma_m=objects.landmark_sigma_m)
