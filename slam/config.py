"""The configuration: one frozen tree, defaults in code, unknown keys refused at every level.

Each component receives only its own branch. The effective tree is written into every output log.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from pydantic import BaseModel, ConfigDict, Field

from slam.config_tree import load_tree


class _Branch(BaseModel):
    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)


class KeyframeConfig(_Branch):
    """When a new keyframe is made: whichever comes first."""

    distance_m: float = Field(default=2.0, gt=0, description="travel since the last keyframe [m]")
    angle_deg: float = Field(default=20.0, gt=0, le=180, description="rotation since the last keyframe [deg]")
    interval_s: float = Field(
        default=5.0, gt=0, description="time since the last keyframe, if the body moved since [s]"
    )


class OdometryConfig(_Branch):
    """Noise of the odometry as a random walk: variances grow in proportion to the travel."""

    translation_sigma: float = Field(
        default=0.05, gt=0, description="translation noise after 1 m of travel [m / sqrt(m)]"
    )
    yaw_sigma: float = Field(default=0.001, gt=0, description="heading noise after 1 m of travel [rad / sqrt(m)]")
    tilt_sigma: float = Field(
        default=0.0003,
        gt=0,
        description="roll and pitch noise after 1 m of travel, which gravity holds [rad / sqrt(m)]",
    )
    min_translation_sigma_m: float = Field(default=0.002, gt=0, description="least translation noise of a step [m]")
    min_rotation_sigma_rad: float = Field(default=0.0001, gt=0, description="least rotation noise of a step [rad]")
    max_speed_mps: float = Field(
        default=60.0, gt=0, description="a faster step is a jump, and ties nothing together [m/s]"
    )
    max_acceleration_mps2: float = Field(
        default=5.0, gt=0, description="a step that would need more than that is a jump, too [m/s^2]"
    )
    max_gap_s: float = Field(
        default=20.0, gt=0, description="a longer silence is a break: landmarks in view are let go [s]"
    )


class DetectionConfig(_Branch):
    """Noise of detections: the message's own covariance where it has one, else sigma = base + per_m * range."""

    base_sigma_m: float = Field(
        default=0.2, gt=0, description="position noise at range 0, where the message has none [m]"
    )
    sigma_per_m: float = Field(default=0.01, ge=0, description="growth of that noise with the range [m / m]")
    common_sigma_m: float = Field(
        default=0.4,
        ge=0,
        description="error that the sightings of one object from one keyframe share, e.g. of a centroid [m]",
    )
    redundancy: float = Field(
        default=500.0,
        ge=1,
        description="observations that carry the information of one, where the message has no covariance: "
        "errors of centroids are shared by the objects in view and by the keyframes of a pass",
    )
    min_sigma_m: float = Field(default=0.01, ge=0, description="added to the message's own covariances [m]")
    min_score: float = Field(default=0.0, ge=0, le=1, description="detections below this score are left out")
    max_range_m: float = Field(default=80.0, gt=0, description="detections farther away are left out [m]")

    assume_body_frame: bool = Field(
        default=False, description="take every detection to be in the body frame, whatever frame its message names"
    )


class AssociationConfig(_Branch):
    """Which detection is which landmark."""

    gate_probability: float = Field(
        default=0.9995,
        gt=0,
        lt=1,
        description="share of true matches that the chi-squared gate (3 degrees of freedom) keeps",
    )
    label_accuracy: float = Field(
        default=0.85, gt=0, lt=1, description="probability that a detection has the right label"
    )
    new_object_density: float = Field(
        default=0.002,
        gt=0,
        description="new objects and false positives a scan and cubic metre [1/m^3]; higher: fewer matches",
    )
    forget_distance_m: float = Field(
        default=120.0, gt=0, description="landmarks unseen for that much travel are met again as new ones [m]"
    )


class LandmarkConfig(_Branch):
    """The life of a landmark: tentative, confirmed, retired."""

    confirm_observations: int = Field(default=4, ge=1, description="sightings that confirm a landmark")
    confirm_fraction: float = Field(
        default=0.4, ge=0, le=1, description="least share of the scans since its first sighting in which it was seen"
    )
    confirm_age_s: float = Field(
        default=1.0,
        ge=0,
        description="least time from its first to its last sighting: what drives by is gone by then [s]",
    )
    give_up_distance_m: float = Field(
        default=15.0, gt=0, description="a tentative landmark unseen for that travel retires [m]"
    )
    give_up_scans: int = Field(default=20, ge=1, description="... or for more than that many scans")
    moving_speed_mps: float = Field(
        default=1.0, gt=0, description="what is faster, and faster than its noise explains, moves [m/s]"
    )
    moving_distance_m: float = Field(default=2.5, gt=0, description="... if it also went at least this far [m]")
    moving_observations: int = Field(default=5, ge=3, description="... and was seen at least that often")
    moving_acceleration_mps2: float = Field(
        default=3.0, gt=0, description="how much a moving object may change its speed [m/s^2]"
    )


class FactorGraphConfig(_Branch):
    """The estimator on GTSAM."""

    observation_kernel: str = Field(
        default="cauchy",
        pattern="^(none|huber|cauchy)$",
        description="robust kernel of observations: none, huber or cauchy",
    )
    observation_kernel_width: float = Field(
        default=1.5, gt=0, description="width of that kernel, in standard deviations"
    )
    relinearize_threshold: float = Field(
        default=0.05, gt=0, description="iSAM2: change of a variable that relinearises it"
    )
    relinearize_skip: int = Field(default=10, ge=1, description="iSAM2: updates between checks for relinearisation")
    update_keyframes: int = Field(default=1, ge=1, description="keyframes between two updates of iSAM2")


class Config(_Branch):
    """Everything that can be set."""

    keyframe: KeyframeConfig = KeyframeConfig()
    odometry: OdometryConfig = OdometryConfig()
    detection: DetectionConfig = DetectionConfig()
    association: AssociationConfig = AssociationConfig()
    landmark: LandmarkConfig = LandmarkConfig()
    factor_graph: FactorGraphConfig = FactorGraphConfig()


def load_config(path: Path | None = None, overrides: Sequence[str] = ()) -> Config:
    """The effective configuration: defaults, then the TOML file, then ``overrides`` like "keyframe.distance_m=1.5".

    Raises:
        ConfigurationError: a file that cannot be read, an unknown key, or a value that is not allowed.
    """
    return load_tree(Config, path, overrides)
