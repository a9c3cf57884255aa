"""The settings: one frozen tree, defaults in code, unknown keys refused at every level.

The properties of a robot's sensors are not settings but the calibration, which a replay estimates from the log as far
as it is not given. The effective tree is written into every output log.
"""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Annotated, Any

import numpy as np
from pydantic import Field, StringConstraints

from logs.container.limits import ReadingLimits
from slam.common.calibration import Calibration
from slam.common.config_tree import Branch, load_tree

_LIMITS = ReadingLimits()
_Name = Annotated[str, StringConstraints(min_length=1)]
SUBMAP_RANGES = 5.0 / 3.0
"""Landmarks seen within that much travel, in sensor ranges, make a submap. Over that travel a closure predicts others,
and between the keyframes of a closure lies twice as much, so that their submaps share no landmark.
"""


class KeyframeConfig(Branch):
    """When a new keyframe is made."""

    distance_m: float | None = Field(default=None, gt=0)
    """travel since the last keyframe; not set: 1/15 of the sensor range [m]"""


class LocalizationConfig(Branch):
    """Where the robot is: the posterior over poses in earlier traversals and "somewhere new"."""

    error_probability: float = Field(default=1e-4, gt=0, lt=1)
    """a pose is accepted if the probability that it is wrong is below this; with a hundred decisions a drive, 0.0001 is
    one false closure in a hundred drives
    """
    failures_per_km: float = Field(default=1e-3, gt=0)
    """undetected failures of the odometry per kilometre [1/km]"""

    def failure_probability(self, travel_m: float) -> float:
        """Probability that the odometry failed unnoticed on some travel, a metre at least."""
        return float(-np.expm1(-self.failures_per_km * max(travel_m, 1.0) / 1000.0))


class LoopClosureConfig(Branch):
    """Retrieval and insertion of loop closures."""

    enabled: bool = True
    """close loops"""
    descriptor: str = "descriptellation_lr"
    """descriptor of constellations: descriptellation_lr, one of the baselines, a file of weights (NAME.safetensors) or
    a class of your own (module:Class)
    """
    min_travel_m: float | None = Field(default=None, gt=0)
    """minimum travel between the two keyframes of a closure; not set: 10/3 of the sensor range [m]"""
    top_k: int = Field(default=6, ge=1)
    """nearest neighbours in descriptor space for each object"""
    max_candidates: int = Field(default=5, ge=1)
    """candidates that are verified for each keyframe and searched map"""
    propagation_distance_m: float | None = Field(default=None, ge=0)
    """travel over which an accepted closure predicts those before and after it; not set: 5/3 of the sensor range [m]"""


class LabelsConfig(Branch):
    """What the classes of detections are called in the map. Old names may hold the wildcards * and ?."""

    rename: dict[str, _Name] = Field(default={})
    """old name = new name; several old ones of one new name become one class"""
    drop: tuple[str, ...] = ()
    """classes that are left out, under their old names"""


class Config(Branch):
    """Everything that can be set, and the calibration of the robot."""

    calibrate: bool = True
    """estimate missing values of the calibration from the log, before it is mapped"""
    keyframe: KeyframeConfig = KeyframeConfig()
    loop_closure: LoopClosureConfig = LoopClosureConfig()
    localization: LocalizationConfig = LocalizationConfig()
    labels: LabelsConfig = LabelsConfig()
    topics: dict[str, str] = Field(default={})
    """part = topic, overridden by --topic; several topics of one part are separated by commas"""
    memory_mb: float = Field(default=_LIMITS.chunk_mb, gt=0, le=1e5)
    """memory for reading a log: one chunk, decompressed; one message takes a quarter of it, and names, channels and
    objects of a message are limited in proportion [MB]
    """
    calibration: Calibration = Calibration()

    @property
    def sensor_range_m(self) -> float:
        """The range [m] that 95 % of the detections keep, of which other lengths are fractions."""
        return self.calibration.detection.sensor_range_m

    @property
    def closure_travel_m(self) -> float:
        """Least travel [m] between the two keyframes of a closure."""
        return self.loop_closure.min_travel_m or 2.0 * SUBMAP_RANGES * self.sensor_range_m

    @property
    def traversal_extent_m(self) -> float:
        """Travel [m] by which a traversal reaches before and after a place: a tenth more than the least between two."""
        return 1.1 * self.closure_travel_m

    @property
    def propagation_distance_m(self) -> float:
        """Travel [m] over which an accepted closure predicts those before and after it."""
        given = self.loop_closure.propagation_distance_m
        return SUBMAP_RANGES * self.sensor_range_m if given is None else given

    def calibrated(self, values: Mapping[str, float]) -> "Config":
        """The same with other values of some dotted keys of the calibration, like "odometry.yaw_sigma"."""
        return self.model_copy(update={"calibration": self.calibration.with_values(values)})

    def closing(self, **values: Any) -> "Config":
        """The same with other values of some settings of loop closures."""
        return self.model_copy(update={"loop_closure": self.loop_closure.model_copy(update=values)})

    @property
    def keyframe_distance_m(self) -> float:
        """Travel [m] from one keyframe to the next: unless it is given, submaps have 25."""
        return self.keyframe.distance_m or SUBMAP_RANGES / 25.0 * self.sensor_range_m

    @property
    def reading_limits(self) -> ReadingLimits:
        """Limits of the memory that a log may take."""
        return _LIMITS.scaled(self.memory_mb / _LIMITS.chunk_mb)


def load_config(
    path: Path | None = None, overrides: Sequence[str] | None = None, *, calibration: Path | None = None
) -> Config:
    """The effective configuration: defaults, then the TOML file, then the file of a calibration that ``dslam
    calibrate`` wrote, then ``overrides`` like "keyframe.distance_m=1.5".

    Raises:
        ConfigurationError: a file that cannot be read, an unknown key, or a value that is not allowed.
    """
    if calibration is not None:
        load_tree(Calibration, calibration, ())  # its own errors name it
    return load_tree(Config, path, overrides, calibration)
