"""What is known of a robot's sensors: noise, scales and faults, estimated from its logs or given by hand.

Lengths of the program that are not here are fractions of ``detection.sensor_range_m``. The defaults are priors:
those of a car with a sensor range of 30 m.
"""

from __future__ import annotations

from collections.abc import Mapping

from pydantic import Field

from slam.common.config_tree import Branch

MAX_TURN = 1000.0
"""Radians of noise after which nothing is known of a heading; covariances with more cannot be inverted."""
MAX_RANGES = 8.0 / 3.0
"""Detections farther away than so many sensor ranges are left out, unless a distance is given."""
UNIQUE_SPACINGS = 100.0
"""Objects of a class that are farther apart than so many sensor ranges never share a scan: they are unique."""


class OdometryCalibration(Branch):
    """Noise of the odometry as a random walk, whose variances grow in proportion to the travel, and its faults."""

    translation_sigma: float = Field(
        default=0.05, gt=0, description="translation noise after 1 m of travel [m / sqrt(m)]"
    )
    yaw_sigma: float = Field(
        default=0.001, gt=0, le=MAX_TURN, description="heading noise after 1 m of travel [rad / sqrt(m)]"
    )
    yaw_sigma_by_turn: float = Field(
        default=0.00316, ge=0, le=MAX_TURN, description="heading noise after turning by 1 rad [rad / sqrt(rad)]"
    )
    translation_sigma_by_time: float = Field(default=0.0, ge=0, description="translation noise after 1 s [m / sqrt(s)]")
    yaw_sigma_by_time: float = Field(
        default=0.0, ge=0, le=MAX_TURN, description="heading noise after 1 s [rad / sqrt(s)]"
    )
    tilt_sigma: float = Field(
        default=0.0003,
        gt=0,
        le=MAX_TURN,
        description="roll and pitch noise after 1 m of travel, which gravity holds [rad / sqrt(m)]",
    )
    min_translation_sigma_m: float = Field(default=0.002, gt=0, description="least translation noise of a step [m]")
    min_rotation_sigma_rad: float = Field(
        default=0.0001, gt=0, le=MAX_TURN, description="least rotation noise of a step [rad]"
    )
    time_offset_s: float = Field(default=0.0, description="added to the stamps of the odometry [s]")
    length_scale: float = Field(default=1.0, gt=0, description="factor on the lengths of the odometry's steps")
    turn_scale: float = Field(default=1.0, gt=0, description="factor on its turns about the vertical")
    sources: int = Field(
        default=1,
        ge=1,
        le=2,
        description="sources that publish on the topic; of two, that of the first message is used",
    )


class DetectionCalibration(Branch):
    """Noise of detections: the message's own covariance where it has one, else sigma = base + per_m * range."""

    sensor_range_m: float = Field(
        default=30.0, gt=0, description="range that 95 % of the detections keep; other lengths are fractions of it [m]"
    )
    farthest_m: float = Field(default=30.0, gt=0, description="range of the farthest detection [m]")
    max_range_m: float | None = Field(
        default=None, gt=0, description="detections farther away are left out; not set: 8/3 of the sensor range [m]"
    )
    min_score: float = Field(default=0.0, ge=0, le=1, description="detections below this score are left out")
    base_sigma_m: float = Field(
        default=0.2, gt=0, description="position noise at range 0, where the message has none [m]"
    )
    sigma_per_m: float = Field(default=0.01, ge=0, description="growth of that noise with the range [m / m]")
    range_sigma_ratio: float = Field(
        default=1.0, gt=0, le=1e4, description="that noise is across the line of sight; along it by that factor"
    )
    common_sigma_m: float = Field(
        default=0.4,
        ge=0,
        description="error that observations of an object from one direction share, e.g. of a centroid: along the "
        "ground, by how much it changes as the direction turns by 1 rad [m]",
    )
    common_height_sigma_m: float = Field(default=0.0, ge=0, description="the same in height [m]")
    height_sigma_m: float = Field(
        default=0.0, ge=0, description="noise of heights beyond that of the position, 0 where there is none [m]"
    )
    covariance_inflation: float = Field(
        default=500.0,
        ge=1,
        description="factor on covariances of observations, where the message has none, for correlated errors: "
        "errors of centroids are shared by the objects in view and by the keyframes of a traversal",
    )
    claimed_sigma_factor: float = Field(
        default=1.0, gt=0, description="factor on the standard deviations that messages claim"
    )
    range_scale: float = Field(default=1.0, gt=0, description="factor on the positions of detections in their sensor")
    time_offset_s: float = Field(default=0.0, description="added to the stamps of detections [s]")
    roll_deg: float = Field(
        default=0.0, ge=-180, le=180, description="detections are turned about the x axis of the body, then [deg]"
    )
    pitch_deg: float = Field(default=0.0, ge=-180, le=180, description="about its y axis, then [deg]")
    yaw_deg: float = Field(
        default=0.0, ge=-180, le=180, description="about its z axis, all beyond the transform of the sensor [deg]"
    )
    assume_body_frame: bool = Field(
        default=False, description="take every detection to be in the body frame, not in the one that its message names"
    )
    assume_odometry_frame: bool = Field(
        default=False, description="the same for the frame of the odometry, as of a tracker whose objects stand still"
    )
    ground_z_m: float = Field(
        default=0.0, description="height of the ground in the body frame, for objects in images without depth [m]"
    )
    tag_size_m: float = Field(
        default=0.0, ge=0, description="side of the black square of tags whose poses are not on /tf; 0: not known [m]"
    )

    @property
    def reach_m(self) -> float:
        """Range [m] beyond which detections are left out."""
        return MAX_RANGES * self.sensor_range_m if self.max_range_m is None else self.max_range_m


class ObjectCalibration(Branch):
    """How the detector sees objects, and how well a landmark is found again."""

    label_accuracy: float = Field(
        default=0.85, gt=0, lt=1, description="probability that a detection has the right label"
    )
    max_classes: int = Field(
        default=256, ge=1, le=10_000, description="classes that are distinguished; later ones share one class"
    )
    detection_probability: float = Field(
        default=1.0, gt=0, le=1, description="probability that an object in view is detected in a scan"
    )
    detection_period: int = Field(
        default=1, ge=1, description="scans from one sighting of an object to the next, as several sensors take turns"
    )
    new_object_density: float = Field(
        default=0.002,
        gt=0,
        description="new objects and false positives a scan and cubic metre [1/m^3]; higher: fewer matches",
    )
    spacing_m: float = Field(
        default=4.0, gt=0, description="distance between objects of a class, up to which they can be confused [m]"
    )
    landmark_sigma_m: float = Field(
        default=0.35, gt=0, description="position error of a landmark between two traversals [m]"
    )
    landmark_sigma_per_m: float = Field(
        default=0.01, ge=0, description="growth of that error with the distance from the keyframe [m / m]"
    )
    landmark_height_sigma_m: float = Field(
        default=0.0, ge=0, description="error of a landmark's height between two traversals beyond that [m]"
    )
    height_sigma_m: float | None = Field(
        default=None,
        ge=0,
        description="noise of heights when objects are matched, e.g. of objects seen in part; not set: 1/100 of the "
        "sensor range [m]",
    )


class Calibration(Branch):
    """All that a log tells of a robot's sensors."""

    odometry: OdometryCalibration = OdometryCalibration()
    detection: DetectionCalibration = DetectionCalibration()
    objects: ObjectCalibration = ObjectCalibration()
    sigmas: dict[str, float] = Field(default={}, description="standard errors of estimated values, by their keys")
    evidence: dict[str, float] = Field(
        default={}, description="how much was surveyed: scans, detections, travel and tracked pairs of detections"
    )

    @property
    def has_unique_objects(self) -> bool:
        """Whether no two objects of a class share a scan."""
        return self.objects.spacing_m > UNIQUE_SPACINGS * self.detection.sensor_range_m

    def with_values(self, values: Mapping[str, float]) -> Calibration:
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
        branches = (self.odometry, self.detection, self.objects)
        return all(
            name in branch.model_fields_set or getattr(branch, name) is None
            for branch in branches
            for name in type(branch).model_fields
        )

    def is_given(self, key: str) -> bool:
        """Whether the value of a dotted key was given, rather than being the default."""
        branch, name = key.split(".")
        return name in getattr(self, branch).model_fields_set
