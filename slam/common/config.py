"""The configuration: one frozen tree, defaults in code, unknown keys refused at every level.

Each component receives only its own branch. The effective tree is written into every output log.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Annotated

from pydantic import BaseModel, ConfigDict, Field, StringConstraints

from logs.container.limits import ReadingLimits
from slam.common.config_tree import load_tree

_LIMITS = ReadingLimits()
_Name = Annotated[str, StringConstraints(min_length=1)]
MOST_TURN = 1000.0
"""Radians of noise after which nothing is known of a heading; covariances with more cannot be inverted."""


class _Branch(BaseModel):
    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)

    def __hash__(self) -> int:
        """By the values, tables included, whose own type has no hash."""
        return hash(self.model_dump_json())


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
    yaw_sigma: float = Field(
        default=0.001, gt=0, le=MOST_TURN, description="heading noise after 1 m of travel [rad / sqrt(m)]"
    )
    yaw_sigma_by_turn: float = Field(
        default=0.00316, ge=0, le=MOST_TURN, description="heading noise after turning by 1 rad [rad / sqrt(rad)]"
    )
    translation_sigma_by_time: float = Field(default=0.0, ge=0, description="translation noise after 1 s [m / sqrt(s)]")
    yaw_sigma_by_time: float = Field(
        default=0.0, ge=0, le=MOST_TURN, description="heading noise after 1 s [rad / sqrt(s)]"
    )
    inflation: float = Field(
        default=3.0,
        ge=1,
        description="factor on these sigmas where a match is in question, for slips and errors that add up",
    )
    tilt_sigma: float = Field(
        default=0.0003,
        gt=0,
        le=MOST_TURN,
        description="roll and pitch noise after 1 m of travel, which gravity holds [rad / sqrt(m)]",
    )
    min_translation_sigma_m: float = Field(default=0.002, gt=0, description="least translation noise of a step [m]")
    min_rotation_sigma_rad: float = Field(
        default=0.0001, gt=0, le=MOST_TURN, description="least rotation noise of a step [rad]"
    )
    max_speed_mps: float = Field(
        default=60.0, gt=0, description="a faster step is a discontinuity of the odometry [m/s]"
    )
    max_acceleration_mps2: float = Field(
        default=5.0, gt=0, description="a step that would need more than that is one, too [m/s^2]"
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
    max_gap_s: float = Field(
        default=20.0, gt=0, description="a longer gap is a discontinuity: active landmarks are dropped [s]"
    )


class DetectionConfig(_Branch):
    """Noise of detections: the message's own covariance where it has one, else sigma = base + per_m * range."""

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
        description="error that the observations of one object from one keyframe share, e.g. of a centroid [m]",
    )
    height_sigma_m: float = Field(
        default=0.0, ge=0, description="noise of heights beyond that of the position, 0 where there is none [m]"
    )
    covariance_inflation: float = Field(
        default=500.0,
        ge=1,
        description="factor on covariances of observations, where the message has none, for correlated errors: "
        "errors of centroids are shared by the objects in view and by the keyframes of a traversal",
    )
    scans_per_view: float = Field(
        default=20.0, ge=1, description="scans in a row in which the errors that observations share stay the same"
    )
    min_sigma_m: float = Field(default=0.01, ge=0, description="added to the message's own covariances [m]")
    min_score: float = Field(default=0.0, ge=0, le=1, description="detections below this score are left out")
    max_range_m: float = Field(default=80.0, gt=0, description="detections farther away are left out [m]")
    sensor_range_m: float = Field(
        default=30.0,
        gt=0,
        description="range that 95 % of the detections keep; lengths that are no settings are fractions of it [m]",
    )

    range_scale: float = Field(default=1.0, gt=0, description="factor on the positions of detections in their sensor")
    claimed_sigma_factor: float = Field(
        default=1.0, gt=0, description="factor on the standard deviations that messages claim"
    )
    time_offset_s: float = Field(default=0.0, description="added to the stamps of detections [s]")
    ground_z_m: float = Field(
        default=0.0, description="height of the ground in the body frame, for objects in images without depth [m]"
    )
    tag_size_m: float = Field(
        default=0.0, ge=0, description="side of the black square of tags whose poses are not on /tf; 0: not known [m]"
    )
    roll_deg: float = Field(
        default=0.0, ge=-180, le=180, description="detections are turned about the x axis of the body, then [deg]"
    )
    pitch_deg: float = Field(default=0.0, ge=-180, le=180, description="about its y axis, then [deg]")
    yaw_deg: float = Field(
        default=0.0, ge=-180, le=180, description="about its z axis, all beyond the transform of the sensor [deg]"
    )
    assume_body_frame: bool = Field(
        default=False, description="take every detection to be in the body frame, whatever frame its message names"
    )
    assume_odometry_frame: bool = Field(
        default=False, description="the same for the frame of the odometry, as of a tracker whose objects stand still"
    )


class AssociationConfig(_Branch):
    """Data association: which detection is which landmark."""

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
    new_object_gate_probability: float = Field(
        default=0.999999,
        gt=0,
        lt=1,
        description="a detection outside the gate of every landmark, but not as far off as that, is left out",
    )
    odometry_inflation: float = Field(
        default=3.0, ge=1, description="factor on the sigmas of the odometry: slips are larger than the noise of a step"
    )
    confusion_distance_m: float = Field(
        default=4.0, gt=0, description="distance between objects of a class, up to which they can be confused [m]"
    )
    active_radius_m: float = Field(
        default=60.0, gt=0, description="landmarks farther from the robot are no longer associated with detections [m]"
    )
    max_landmarks: int = Field(
        default=200, ge=10, description="landmarks around the robot that are kept for association, the latest seen"
    )
    max_classes: int = Field(
        default=256, ge=1, le=10_000, description="classes that are told apart; all that come later are one class"
    )


class LandmarkConfig(_Branch):
    """Life cycle of a landmark: tentative, confirmed, retired."""

    confirm_observations: int = Field(default=4, ge=1, description="observations that confirm a landmark")
    confirm_fraction: float = Field(
        default=0.4,
        ge=0,
        le=1,
        description="least share of the scans since its first observation in which it was observed",
    )
    confirm_age_s: float = Field(
        default=1.0,
        ge=0,
        description="least time from its first to its last observation, to exclude passing objects [s]",
    )
    max_missed_distance_m: float = Field(
        default=15.0, gt=0, description="a tentative landmark unseen for that travel retires [m]"
    )
    max_missed_scans: int = Field(default=20, ge=1, description="... or for more than that many scans")
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
    update_keyframes: int = Field(
        default=5, ge=1, description="keyframes between two updates of iSAM2; in between the local map goes on"
    )
    observed_keyframes: int = Field(
        default=4,
        ge=1,
        description="so many keyframes in a row observe a landmark once where the odometry between them is far better "
        "than a detection; elsewhere iSAM2 takes in one keyframe in so many, and the batch solution all",
    )


class SubmapConfig(_Branch):
    """Submaps: landmarks of the last stretch of travel, registered with those of an earlier traversal."""

    travel_m: float = Field(default=50.0, gt=0, description="landmarks seen within that much travel make a submap [m]")
    landmark_sigma_m: float = Field(
        default=0.35, gt=0, description="position error of a landmark between two traversals [m]"
    )
    sigma_per_m: float = Field(
        default=0.01, ge=0, description="growth of that error with the distance from the keyframe [m / m]"
    )


class LikelihoodRatioConfig(_Branch):
    """The likelihood ratio of same place against clutter; see slam/loop_closure/likelihood_ratio.py."""

    detection_probability: float = Field(
        default=0.85,
        gt=0,
        lt=1,
        description="P_D: probability that an object of one traversal is in the map of another",
    )
    coverage_radius_m: float = Field(
        default=10.0, gt=0, description="a match is expected within that distance of any reference landmark [m]"
    )
    clutter_radius_m: float = Field(
        default=5.0, gt=0, description="radius within which landmarks of the same class count as clutter [m]"
    )
    clutter_along_track_m: float = Field(
        default=45.0, gt=0, description="distance along the direction of travel within which they also count [m]"
    )
    clutter_cross_track_sigma_m: float = Field(
        default=0.7, gt=0, description="... and standard deviation of the Gaussian profile across it [m]"
    )


class LocalizationConfig(_Branch):
    """Where the robot is: the posterior over poses in earlier traversals and "somewhere new"."""

    error_probability: float = Field(
        default=1e-4,
        gt=0,
        lt=1,
        description="a pose is accepted once the probability that it is wrong is below that; with a hundred decisions "
        "a drive, 0.0001 is one false closure in a hundred drives",
    )
    failures_per_km: float = Field(
        default=1e-3, gt=0, description="undetected failures of the odometry on a kilometre of travel [1/km]"
    )
    max_hypotheses: int = Field(
        default=5, ge=0, description="hypotheses that are carried from keyframe to keyframe, the likeliest ones"
    )


class LoopClosureConfig(_Branch):
    """Retrieval, acceptance and insertion of loop closures. LLR: log-likelihood ratio of a candidate."""

    enabled: bool = Field(default=True, description="close loops")
    descriptor: str = Field(
        default="descriptellation_lr",
        description="descriptor of constellations: descriptellation_lr, ring_likelihood, one of the baselines, a "
        "file of weights (NAME.safetensors) or a class of your own (module:Class)",
    )
    min_travel_m: float = Field(
        default=100.0, gt=0, description="least travel between the two keyframes of a closure [m]"
    )
    inactive_travel_m: float = Field(
        default=60.0, gt=0, description="a landmark unseen for that travel is added to the index of descriptors [m]"
    )
    top_k: int = Field(default=6, ge=1, description="nearest neighbours in descriptor space for each object")
    max_candidates: int = Field(
        default=3, ge=1, description="candidates by descriptors that are verified for each keyframe"
    )
    max_candidates_by_triangles: int = Field(
        default=3,
        ge=0,
        description="... and those by triangles of neighbouring objects, which need no classes; 0: descriptors alone",
    )
    max_candidates_when_lost: int = Field(
        default=5, ge=0, description="... and those of the exhaustive search that are verified while the robot is lost"
    )
    propagation_distance_m: float = Field(
        default=50.0, ge=0, description="travel over which an accepted closure predicts those before and after it [m]"
    )
    insert_travel_m: float = Field(
        default=20.0, ge=0, description="least travel between two closures that become factors of the graph [m]"
    )
    base_sigma_m: float = Field(
        default=0.3, gt=0, description="translation error of a closure that its inliers share [m]"
    )
    base_height_sigma_m: float = Field(
        default=0.0, ge=0, description="error of the height of a closure beyond that of its translation [m]"
    )
    base_sigma_deg: float = Field(default=0.8, gt=0, description="heading error of a closure that they share [deg]")
    tilt_sigma_deg: float = Field(default=1.0, gt=0, description="error of gravity between two traversals [deg]")


class RegistrationConfig(_Branch):
    """Registration of one constellation of objects with another."""

    method: str = Field(
        default="vote",
        pattern="^(vote|ransac)$",
        description="poses are proposed by all compatible pairs of correspondences (vote) or by pairs drawn (ransac)",
    )
    gate_sigma: float = Field(
        default=3.0, gt=0, description="residuals and differences of lengths beyond that many sigmas are no match"
    )
    height_sigma_m: float = Field(
        default=0.3, ge=0, description="noise of heights beyond that of the position, e.g. of objects seen in part [m]"
    )
    tilt_sigma_rad: float = Field(
        default=0.005, gt=0, description="how well gravity holds roll and pitch of the two frames together [rad]"
    )
    min_baseline_m: float = Field(
        default=3.0, gt=0, description="least horizontal distance of two objects that propose a heading [m]"
    )
    min_inliers: int = Field(default=3, ge=2, description="least pairs of objects that support a pose")
    hypotheses: int = Field(default=64, ge=1, description="poses with most votes that are scored")
    confidence: float = Field(
        default=0.9999,
        gt=0,
        lt=1,
        description="voting ends once a pose with more support would have been met with this probability",
    )
    max_pairs: int = Field(default=20_000_000, ge=1, description="... or after that many pairs of correspondences")
    search_radius_m: float = Field(
        default=3.0, gt=0, description="refinement from an approximate pose looks that far for partners at first [m]"
    )
    max_iterations: int = Field(default=8, ge=1, description="rounds of association and least squares")
    distinct_m: float = Field(
        default=2.0, gt=0, description="poses nearer to a better one in position, at the centre of the objects, [m] ..."
    )
    distinct_deg: float = Field(default=10.0, gt=0, le=180, description="... and in heading are the same pose [deg]")
    six_dof: bool = Field(
        default=False, description="estimate roll and pitch, too, instead of taking both frames as level"
    )
    estimate_scale: bool = Field(
        default=False, description="estimate a scale of the query, for ranges that are measured too long or too short"
    )
    scale_sigma: float = Field(default=0.05, gt=0, lt=1, description="how far that scale is from 1")


class LimitsConfig(_Branch):
    """How much of a log is taken into memory, whatever it asks for; what goes beyond is left out, and told."""

    chunk_mb: float = Field(default=_LIMITS.chunk_mb, gt=0, le=1e5, description="one chunk, decompressed [MB]")
    message_mb: float = Field(default=_LIMITS.message_mb, gt=0, le=1e5, description="one message that is used [MB]")
    waiting_mb: float = Field(
        default=_LIMITS.waiting_mb, gt=0, le=1e5, description="messages that wait because chunks overlap in time [MB]"
    )
    metadata_mb: float = Field(default=_LIMITS.metadata_mb, gt=0, le=1e5, description="all metadata [MB]")
    channels: int = Field(default=_LIMITS.channels, ge=1, le=65_536, description="channels, and schemas")
    objects: int = Field(default=_LIMITS.objects, ge=1, le=10_000_000, description="objects in one message")
    name_length: int = Field(
        default=_LIMITS.name_length, ge=1, le=10_000_000, description="name of a topic, a frame or a class [characters]"
    )

    @property
    def reading(self) -> ReadingLimits:
        """The same for the reader of logs."""
        return ReadingLimits(**self.model_dump())


class LabelsConfig(_Branch):
    """What the classes of detections are called in the map. Old names may hold the wildcards * and ?."""

    rename: dict[str, _Name] = Field(
        default={}, description="old name = new name; several old ones of one new name become one class"
    )
    merge: dict[_Name, tuple[str, ...]] = Field(default={}, description="new name = list of old names")
    drop: tuple[str, ...] = Field(default=(), description="classes that are left out, under their old names")


class CalibrationConfig(_Branch):
    """What a replay estimates from the log before it maps it."""

    enabled: bool = Field(
        default=True, description="estimate lengths and noise from the log, but for those that are set by hand"
    )


class Config(_Branch):
    """Everything that can be set."""

    calibration: CalibrationConfig = CalibrationConfig()
    keyframe: KeyframeConfig = KeyframeConfig()
    odometry: OdometryConfig = OdometryConfig()
    detection: DetectionConfig = DetectionConfig()
    association: AssociationConfig = AssociationConfig()
    landmark: LandmarkConfig = LandmarkConfig()
    factor_graph: FactorGraphConfig = FactorGraphConfig()
    submap: SubmapConfig = SubmapConfig()
    likelihood_ratio: LikelihoodRatioConfig = LikelihoodRatioConfig()
    loop_closure: LoopClosureConfig = LoopClosureConfig()
    registration: RegistrationConfig = RegistrationConfig()
    labels: LabelsConfig = LabelsConfig()
    topics: dict[str, str] = Field(
        default={},
        description="part = topic, as --topic, which wins; several topics of one part are separated by commas",
    )
    limits: LimitsConfig = LimitsConfig()
    localization: LocalizationConfig = LocalizationConfig()


def load_config(path: Path | None = None, overrides: Sequence[str] = ()) -> Config:
    """The effective configuration: defaults, then the TOML file, then ``overrides`` like "keyframe.distance_m=1.5".

    Raises:
        ConfigurationError: a file that cannot be read, an unknown key, or a value that is not allowed.
    """
    return load_tree(Config, path, overrides)
