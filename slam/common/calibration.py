"""Calibration of a robot's sensors: noise, scales and faults, estimated from its logs or given by hand.

Lengths of the program that are not here are fractions of ``detection.sensor_range_m``. The defaults are priors:
those of a car with a sensor range of 30 m.
"""

from collections.abc import Mapping
from operator import attrgetter

import numpy as np
from pydantic import Field
from scipy.spatial.transform import Rotation

from slam.common.arrays import FloatArray
from slam.common.config_tree import Branch

MAX_TURN = 1000.0
"""Radians of noise after which nothing is known of a heading; covariances with more cannot be inverted."""


class OdometryCalibration(Branch):
    """Noise of the odometry as a random walk, whose variances grow in proportion to the travel, and its faults."""

    translation_sigma: float = Field(default=0.05, gt=0)
    """translation noise after 1 m of travel [m / sqrt(m)]"""
    yaw_sigma: float = Field(default=0.001, gt=0, le=MAX_TURN)
    """heading noise after 1 m of travel [rad / sqrt(m)]"""
    yaw_sigma_by_turn: float = Field(default=0.00316, ge=0, le=MAX_TURN)
    """heading noise after turning by 1 rad [rad / sqrt(rad)]"""
    translation_sigma_by_time: float = Field(default=0.0, ge=0)
    """translation noise after 1 s [m / sqrt(s)]"""
    yaw_sigma_by_time: float = Field(default=0.0, ge=0, le=MAX_TURN)
    """heading noise after 1 s [rad / sqrt(s)]"""
    tilt_sigma: float = Field(default=0.0003, gt=0, le=MAX_TURN)
    """noise of roll and pitch after 1 m of travel [rad / sqrt(m)]"""
    min_translation_sigma_m: float = Field(default=0.002, gt=0)
    """minimum translation noise of a step [m]"""
    min_rotation_sigma_rad: float = Field(default=0.0001, gt=0, le=MAX_TURN)
    """minimum rotation noise of a step [rad]"""
    time_offset_s: float = 0.0
    """added to the stamps of the odometry [s]"""
    length_scale: float = Field(default=1.0, gt=0)
    """factor on the lengths of the odometry's steps"""
    turn_scale: float = Field(default=1.0, gt=0)
    """factor on the rotations of the odometry about the vertical axis"""
    roll_deg: float = Field(default=0.0, ge=-180, le=180)
    """rotation of the odometry frame about its x axis, applied first, by which it becomes level [deg]"""
    pitch_deg: float = Field(default=0.0, ge=-90, le=90)
    """rotation about its y axis, applied second [deg]"""
    climb: float = Field(default=0.0, ge=-1, le=1)
    """height that the odometry lacks per metre of travel [m / m]"""
    drift_deg_per_s: float = 0.0
    """turn that the odometry lacks per second, as by the bias of a gyroscope [deg / s]"""
    curvature_deg_per_m: float = 0.0
    """turn that the odometry lacks per metre of travel, as by wheels of unequal diameter [deg / m]"""

    @property
    def T_level_odom(self) -> FloatArray:
        """The rotation (4, 4) by which the frame of the messages becomes level."""
        T = np.eye(4)
        T[:3, :3] = Rotation.from_euler("xy", (self.roll_deg, self.pitch_deg), degrees=True).as_matrix()
        return T


class DetectionCalibration(Branch):
    """Noise of detections: the message's own covariance where it has one, else sigma = base + per_m * range."""

    sensor_range_m: float = Field(default=30.0, gt=0)
    """95th percentile of the ranges; other lengths are fractions of it [m]"""
    farthest_m: float = Field(default=30.0, gt=0)
    """range of the farthest detection [m]"""
    max_range_m: float | None = Field(default=None, gt=0)
    """detections farther away are left out; not set: 8/3 of the sensor range [m]"""
    min_score: float = Field(default=0.0, ge=0, le=1)
    """detections below this score are left out"""
    base_sigma_m: float = Field(default=0.2, gt=0)
    """position noise at range 0, where the message has none [m]"""
    sigma_per_m: float = Field(default=0.01, ge=0)
    """growth of that noise with the range [m / m]"""
    range_sigma_ratio: float = Field(default=1.0, gt=0, le=1e4)
    """ratio of the noise along the line of sight to that across it"""
    common_sigma_m: float = Field(default=0.4, ge=0)
    """error shared by the observations of an object from one view, e.g. of a centroid, along the ground: how much it
    changes as the bearing changes by 1 rad or the range changes by a factor of e [m]
    """
    common_height_sigma_m: float = Field(default=0.0, ge=0)
    """the same in height [m]"""
    height_sigma_m: float = Field(default=0.0, ge=0)
    """additional noise of heights, 0 if there is none [m]"""
    covariance_inflation: float = Field(default=500.0, ge=1)
    """factor on covariances of observations, where the message has none, for correlated errors: errors of centroids are
    shared by the objects in view and by the keyframes of a traversal
    """
    resolution_m: float = Field(default=0.0, ge=0)
    """of detections of one label that are nearer to one another than that, the one with the highest score is used [m]
    """
    claimed_sigma_factor: float = Field(default=1.0, gt=0)
    """factor on the standard deviations in messages"""
    range_scale: float = Field(default=1.0, gt=0)
    """factor on the positions of detections in the sensor frame"""
    time_offset_s: float = 0.0
    """added to the stamps of detections [s]"""
    stamp_sigma_s: float = Field(default=0.0, ge=0)
    """noise of the stamps of detections against those of the odometry [s]"""
    roll_deg: float = Field(default=0.0, ge=-180, le=180)
    """rotation of detections about the x axis of the body, applied first [deg]"""
    pitch_deg: float = Field(default=0.0, ge=-180, le=180)
    """rotation about the y axis of the body, applied second [deg]"""
    yaw_deg: float = Field(default=0.0, ge=-180, le=180)
    """rotation about the z axis of the body, applied last, besides the transform of the sensor [deg]"""
    x_m: float = 0.0
    """offset along the x axis of the body, besides the transform of the sensor [m]"""
    y_m: float = 0.0
    """offset along the y axis of the body, besides the transform of the sensor [m]"""
    assume_body_frame: bool = False
    """interpret detections in the body frame instead of that of the message"""
    assume_odometry_frame: bool = False
    """interpret detections in the odometry frame instead of that of the message"""
    ground_z_m: float = 0.0
    """height of the ground in the body frame, for objects in images without depth [m]"""
    tag_size_m: float = Field(default=0.0, ge=0)
    """side of the black square of tags without poses on /tf; 0: unknown [m]"""

    @property
    def reach_m(self) -> float:
        """Range [m] beyond which detections are left out."""
        return self.max_range_m or 8.0 / 3.0 * self.sensor_range_m

    @property
    def view_variances(self) -> FloatArray:
        """Variances (3,) m^2 of what observations in one view share, by coordinate."""
        return np.square([self.common_sigma_m, self.common_sigma_m, self.common_height_sigma_m])


class ObjectCalibration(Branch):
    """How the detector sees objects, and how well a landmark is found again."""

    label_accuracy: float = Field(default=0.85, gt=0, lt=1)
    """probability that a detection has the right label"""
    max_classes: int = Field(default=256, ge=1, le=10_000)
    """maximum number of classes; later ones share one class"""
    detection_probability: float = Field(default=1.0, gt=0, le=1)
    """probability that an object in view is detected in a scan"""
    detection_period: int = Field(default=1, ge=1)
    """scans between detections of an object, more than 1 if several sensors take turns"""
    new_object_density: float = Field(default=0.002, gt=0)
    """new objects and false positives per scan and cubic metre [1/m^3]; higher: fewer matches"""
    spacing_m: float = Field(default=4.0, gt=0)
    """distance below which objects of a class can be confused [m]"""
    landmark_sigma_m: float = Field(default=0.35, gt=0)
    """position error of a landmark between two traversals [m]"""
    landmark_sigma_per_m: float = Field(default=0.01, ge=0)
    """growth of that error with the distance from the keyframe [m / m]"""
    landmark_height_sigma_m: float = Field(default=0.0, ge=0)
    """additional error of the height of a landmark between two traversals [m]"""
    height_sigma_m: float | None = Field(default=None, ge=0)
    """noise of heights in matching, e.g. of objects seen in part; not set: 1/100 of the range [m]"""


class Calibration(Branch):
    """Everything that is estimated about the sensors of a robot."""

    odometry: OdometryCalibration = OdometryCalibration()
    detection: DetectionCalibration = DetectionCalibration()
    objects: ObjectCalibration = ObjectCalibration()
    sigmas: dict[str, float] = Field(default={})
    """standard errors of the estimated values, by key"""
    evidence: dict[str, float] = Field(default={})
    """amount of data: scans, detections, travel and tracked pairs of detections"""

    def with_values(self, values: Mapping[str, float]) -> "Calibration":
        """The same with other values of some dotted keys, like "odometry.yaw_sigma"; they are not checked."""
        branches: dict[str, dict[str, float]] = {}
        for key, value in values.items():
            branch, name = key.split(".")
            branches.setdefault(branch, {})[name] = value
        return self.model_copy(
            update={name: getattr(self, name).model_copy(update=update) for name, update in branches.items()}
        )

    @property
    def is_complete(self) -> bool:
        """Whether nothing is left to be estimated: all values were given that must have one."""
        return all(
            name in branch.model_fields_set or value is None
            for branch in (self.odometry, self.detection, self.objects)
            for name, value in branch
        )

    def value_of(self, key: str) -> float:
        """The value of a dotted key, like "odometry.yaw_sigma"."""
        return float(attrgetter(key)(self))

    def is_given(self, key: str) -> bool:
        """Whether the value of a dotted key was given, rather than being the default."""
        branch, name = key.split(".")
        return name in getattr(self, branch).model_fields_set
