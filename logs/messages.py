"""The records a log holds: what comes out of the reader and goes into the writer.

Every record is frozen, holds plain NumPy arrays and strings, and knows neither MCAP nor SLAM. Common conventions:

* ``stamp_ns``: integer nanoseconds, the time of the measurement (not the time at which it was logged).
* ``T_a_b``: ``(4, 4)`` float64 homogeneous transform, ``p_a = T_a_b @ p_b``, metres.
* Pose covariances: ``(6, 6)`` float64 in GTSAM's order (rotation x y z [rad], then translation x y z [m]),
  in the tangent space of the right-hand frame (body).
* ``(N, ...)`` arrays may have N = 0.

Odometry, detections, transforms and true poses refuse other shapes, types and matrices when they are made
(``InvalidRecordError``).
"""

from collections.abc import Sequence
from dataclasses import field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from logs.clouds.labelled_cloud import LabelledCloud
from logs.records import check_objects, check_pose, frozen

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]


@frozen
class Odometry:
    """Pose of the body in the smooth, drifting ``odom`` frame."""

    stamp_ns: int
    T_odom_body: FloatArray
    frame_id: str = "odom"
    child_frame_id: str = "base_link"

    def __post_init__(self) -> None:
        check_pose(self, "T_odom_body")


@frozen
class ObjectDetections:
    """Objects seen in one sensor frame: ``positions`` (N, 3) m in ``frame_id``, a label and a score in [0, 1] each.

    ``covariances`` (N, 3, 3) m^2 are None where the detector gives none; one of zeros is unknown.
    """

    stamp_ns: int
    frame_id: str
    positions: FloatArray
    labels: tuple[str, ...]
    scores: FloatArray
    covariances: FloatArray | None = None

    def __post_init__(self) -> None:
        check_objects(self)


@frozen
class ImageDetections:
    """Objects seen in an image: ``boxes`` (N, 4) px, centre u, v, width, height; ``corners`` (N, 4, 2) px of square
    tags, from the lower left counterclockwise as the tag stands; ``frame_id``: the camera's.
    """

    stamp_ns: int
    frame_id: str
    boxes: FloatArray
    labels: tuple[str, ...]
    scores: FloatArray
    corners: FloatArray | None = None


@frozen
class CameraModel:
    """How a camera projects: ``K`` (3, 3) px; ``distortion`` (D,), coefficients of ``model`` as ROS names it."""

    stamp_ns: int
    frame_id: str
    K: FloatArray
    distortion: FloatArray
    model: str


@frozen
class DepthImage:
    """``depths`` (H, W) float32, metres along the axis of the camera, NaN where unknown."""

    stamp_ns: int
    frame_id: str
    depths: NDArray[np.float32]


@frozen
class LabelledScan:
    """One scan of a LiDAR, in ``frame_id``."""

    stamp_ns: int
    frame_id: str
    cloud: LabelledCloud


@frozen
class Transform:
    """Pose of frame ``child_frame_id`` in frame ``parent_frame_id``."""

    stamp_ns: int
    parent_frame_id: str
    child_frame_id: str
    T_parent_child: FloatArray

    def __post_init__(self) -> None:
        check_pose(self, "T_parent_child")


@frozen
class GeodeticFix:
    """Where satellites see the robot: latitude and longitude [deg] and altitude [m] on WGS 84.

    ``covariance`` (3, 3) m^2 of east, north and up, None where unknown.
    """

    stamp_ns: int
    frame_id: str
    latitude_deg: float
    longitude_deg: float
    altitude_m: float
    covariance: FloatArray | None = None


@frozen
class GroundTruthPose:
    """True pose of the body. The estimator never reads it."""

    stamp_ns: int
    T_world_body: FloatArray
    frame_id: str = "world"

    def __post_init__(self) -> None:
        check_pose(self, "T_world_body")


@frozen
class DetectionTruth:
    """True object id of each detection of the ObjectDetections message with the same stamp; "" for a false positive."""

    stamp_ns: int
    object_ids: tuple[str, ...]


@frozen
class ObjectMapRecord:
    """All landmarks of an object map at one time, or, on a truth topic, the true objects.

    positions (N, 3) m in ``frame_id``; covariances (N, 3, 3) m^2; class_probabilities (N, C) over ``vocabulary``
    (rows sum to 1); states: "tentative" | "confirmed" | "retired"; reasons: why it has that state, "" if plain;
    observation_counts (N,); first_seen_ns, last_seen_ns (N,). merged_into: id of the landmark that stands for each, ""
    for itself; empty where none was merged.
    """

    stamp_ns: int
    frame_id: str
    vocabulary: tuple[str, ...]
    ids: tuple[str, ...]
    positions: FloatArray
    covariances: FloatArray
    class_probabilities: FloatArray
    states: tuple[str, ...]
    reasons: tuple[str, ...]
    observation_counts: IntArray
    first_seen_ns: IntArray
    last_seen_ns: IntArray
    merged_into: tuple[str, ...] = ()

    @staticmethod
    def of_objects(
        ids: Sequence[str],
        positions: FloatArray,
        classes: Sequence[int] | NDArray[np.integer[Any]],
        vocabulary: tuple[str, ...],
        *,
        stamp_ns: int = 0,
        frame_id: str = "map",
        sigma_m: float = 0.0,
        observations: int = 0,
    ) -> "ObjectMapRecord":
        """Objects (N,) of known ``classes`` (N,), rows of the vocabulary, as confirmed landmarks seen at that stamp.

        ``sigma_m``: standard deviation of the positions (N, 3) on each axis; ``observations``: of each object.
        """
        count = len(ids)
        seen_ns = np.full(count, stamp_ns, dtype=np.int64)
        return ObjectMapRecord(
            stamp_ns=stamp_ns,
            frame_id=frame_id,
            vocabulary=vocabulary,
            ids=tuple(ids),
            positions=positions,
            covariances=np.broadcast_to(sigma_m**2 * np.eye(3), (count, 3, 3)),
            class_probabilities=np.eye(len(vocabulary))[np.asarray(classes, dtype=np.int64)],
            states=("confirmed",) * count,
            reasons=("",) * count,
            observation_counts=np.full(count, observations, dtype=np.int64),
            first_seen_ns=seen_ns,
            last_seen_ns=seen_ns,
        )

    @property
    def is_confirmed(self) -> NDArray[np.bool_]:
        """Which objects (N,) are confirmed landmarks."""
        return np.array([state == "confirmed" for state in self.states], dtype=np.bool_)

    @property
    def classes(self) -> IntArray:
        """The most probable class (N,) of each object; ties go to the class that comes first in the vocabulary."""
        return np.argmax(self.class_probabilities, axis=1) if self.vocabulary else np.zeros(0, dtype=np.int64)

    @property
    def labels(self) -> tuple[str, ...]:
        """The names of the most probable classes."""
        return tuple(self.vocabulary[i] for i in self.classes)


@frozen
class DetectionAssociations:
    """Landmark id to which each detection of the ObjectDetections with the same stamp was assigned; "" for none.

    ``created`` (N,) bool: the landmark was made from this very detection, so nothing was associated yet.
    """

    stamp_ns: int
    landmark_ids: tuple[str, ...]
    created: NDArray[np.bool_]


@frozen
class SlamPose:
    """Estimated pose as it was known at that time."""

    stamp_ns: int
    T_map_body: FloatArray


@frozen
class TrajectoryRecord:
    """The final trajectory, one pose for each odometry message: stamps_ns (N,), T_map_body (N, 4, 4)."""

    stamp_ns: int
    frame_id: str
    stamps_ns: IntArray
    T_map_body: FloatArray


@frozen
class FactorGraphRecord:
    """The optimised graph: keyframes, the edges between them, and the observations of landmarks from them.

    keyframe_ids (K,), keyframe_stamps_ns (K,), T_map_body (K, 4, 4); pose_covariances (K, 6, 6), the marginals of the
    poses, in the map whose frame the first keyframe holds; (0, 6, 6) where they are not known.
    edge_keyframe_ids (E, 2) as (from, to) with edge_transforms (E, 4, 4) = T_from_to, edge_covariances (E, 6, 6),
    edge_kinds: "odometry" | "discontinuity" (of the odometry: no information) | "closure" | "gnss" | "condensed".
    observation_keyframe_ids (O,), observation_landmark_ids, observation_positions (O, 3) m in the body frame of the
    keyframe, observation_covariances (O, 3, 3) m^2; observation_redundancies (O,), by which those covariances were
    widened because so many observations share their errors, less than 1 where one sums up several keyframes, so that
    the robust kernel stays as wide; (0,) where all are 1.
    """

    stamp_ns: int
    keyframe_ids: IntArray
    keyframe_stamps_ns: IntArray
    T_map_body: FloatArray
    edge_keyframe_ids: IntArray
    edge_transforms: FloatArray
    edge_covariances: FloatArray
    edge_kinds: tuple[str, ...]
    observation_keyframe_ids: IntArray
    observation_landmark_ids: tuple[str, ...]
    observation_positions: FloatArray
    observation_covariances: FloatArray
    pose_covariances: FloatArray = field(default_factory=lambda: np.zeros((0, 6, 6)))
    observation_redundancies: FloatArray = field(default_factory=lambda: np.zeros(0))


@frozen
class LoopClosureRecord:
    """One loop-closure candidate and its decision, accepted or not. ``T_reference_query`` is None before registration.

    ``stage``: where it was decided, one of :class:`logs.closures.Stage`; ``reason``: why. ``stamp_ns`` is that of the
    query keyframe. A later record about the same two keyframes replaces an earlier one. ``inserted``: the closure is
    a factor of the graph; an accepted one that repeats what another says already is none. ``proposer``: who
    proposed the place: "descriptor", of what was seen before; "map index", of an imported map; "prediction", of
    closures that the odometry carries on; "" without a proposal.

    What the decision is made from, None where it was not computed; log-likelihood ratios in nats:
    ``log_likelihood_ratio`` of the place against chance; ``odometry_penalty``: the negative log-likelihood of the
    odometry residual, ``score`` is the difference of the two; ``posterior_log_odds`` of this place against
    all others and somewhere new; ``seed_query_keyframe_id``: query of the closure that predicted this one.
    """

    stamp_ns: int
    query_keyframe_id: int
    reference_keyframe_id: int
    accepted: bool
    stage: str
    reason: str
    inlier_count: int = 0
    score: float = 0.0
    T_reference_query: FloatArray | None = None
    covariance: FloatArray | None = None
    reference_stamp_ns: int = 0
    inserted: bool = False
    log_likelihood_ratio: float | None = None
    odometry_penalty: float | None = None
    posterior_log_odds: float | None = None
    seed_query_keyframe_id: int | None = None
    proposer: str = ""


@frozen
class StatusRecord:
    """State of the system and why it is in it; ``counters``: what was done and what was dropped since the start."""

    stamp_ns: int
    state: str
    level: str
    message: str
    counters: dict[str, int] = field(default_factory=dict)


@frozen
class LocalizationRecord:
    """How well the robot knows where it is, at a scan; ``state`` is that of StatusRecord.

    ``lost_probability``: that it is not where it is taken to be. innovation_ratios (S,): of ``sources`` ("odometry",
    "detections") the squared innovation by its variance and the gate: below 0.5 is normal, above 1 the source is
    rejected. covariance (6, 6): of the pose against the landmarks in view, None before three were seen.
    """

    stamp_ns: int
    state: str
    lost_probability: float
    sources: tuple[str, ...]
    innovation_ratios: FloatArray
    covariance: FloatArray | None = None


@frozen
class SceneMarkers:
    """Objects as a viewer shows them: shapes of one class share a colour and a text.

    positions (N, 3) m in ``frame_id``, classes (N,), rows of the ``vocabulary``, ids (N,); they take the place of
    all that were shown before.
    """

    stamp_ns: int
    frame_id: str
    positions: FloatArray
    vocabulary: tuple[str, ...]
    classes: IntArray
    ids: tuple[str, ...]


@frozen
class SceneLines:
    """Polylines (n, 3) m in ``frame_id`` as a viewer shows them; they take the place of all that were shown before.

    ``color``: red, green, blue, alpha in [0, 1].
    """

    stamp_ns: int
    frame_id: str
    polylines: tuple[FloatArray, ...]
    color: tuple[float, float, float, float]


@frozen
class ScenePoints:
    """Points as a viewer shows them, in the place of all that were shown before.

    positions (N, 3) m in ``frame_id``; colors (N, 4): red, green, blue, alpha in [0, 1].
    """

    stamp_ns: int
    frame_id: str
    positions: FloatArray
    colors: FloatArray


@frozen
class FrameTree:
    """All frames that are known at one time."""

    stamp_ns: int
    transforms: tuple[Transform, ...]


@frozen
class LogMessage:
    """A line of text for viewers. ``level``: "info" | "warning" | "error"."""

    stamp_ns: int
    level: str
    text: str


Record = (
    Odometry
    | ObjectDetections
    | ImageDetections
    | CameraModel
    | DepthImage
    | LabelledScan
    | GeodeticFix
    | Transform
    | GroundTruthPose
    | DetectionTruth
    | ObjectMapRecord
    | DetectionAssociations
    | SlamPose
    | TrajectoryRecord
    | FactorGraphRecord
    | LoopClosureRecord
    | StatusRecord
    | LocalizationRecord
    | SceneMarkers
    | SceneLines
    | ScenePoints
    | FrameTree
    | LogMessage
)
