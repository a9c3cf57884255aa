"""The map that one drive made, and where it lies in the world."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np

from logs.messages import GroundTruthPose, Record
from slam.common.arrays import FloatArray
from slam.common.config import Config
from slam.common.errors import SavedMapError
from slam.common.geometry import invert
from slam.evaluation.inputs.synchronization import PoseSeries, clean_poses, synchronize
from slam.evaluation.metrics.alignment import align_path
from slam.evaluation.metrics.trajectory import compute_absolute_error
from slam.localization.prior_map import PriorMap
from slam.object_map.map_io import SavedMap, confirmed
from slam.system import Slam

MAX_TRUTH_GAP_S = 1.5


@dataclass(frozen=True, slots=True, eq=False)
class KnownMap:
    """A map that one drive made, of which ``T_map_body`` and ``T_world_body_gt`` (K, 4, 4) are the poses.

    ``T_world_map`` (4, 4) lays the whole drive on the truth, from which it then is ``ate_m`` away (rmse).
    """

    saved: PriorMap
    T_map_body: FloatArray
    T_world_body_gt: FloatArray
    T_world_map: FloatArray
    ate_m: float

    @property
    def landmark_count(self) -> int:
        """Landmarks of the map."""
        return len(self.saved.objects.ids) if isinstance(self.saved, SavedMap) else len(self.saved)

    @property
    def driven(self) -> SavedMap:
        """The map, where a drive made it.

        Raises:
            SavedMapError: the map has no trajectory.
        """
        if not isinstance(self.saved, SavedMap):
            raise SavedMapError("the map was imported, and has no keyframes; give one that 'dslam replay' saved")
        return self.saved

    def to_world(self, T_map_body: FloatArray) -> FloatArray:
        """Where a pose (4, 4) in the map is, by the whole drive."""
        return self.T_world_map @ T_map_body

    def to_world_nearby(self, T_map_body: FloatArray, T_world_near: FloatArray) -> FloatArray:
        """The same by the pose of the drive that came nearest to a place: without the distortion of the map."""
        offsets = self.T_world_body_gt[:, :2, 3] - T_world_near[:2, 3]
        row = int(np.argmin(np.einsum("ij,ij->i", offsets, offsets)))
        return np.asarray(self.T_world_body_gt[row] @ invert(self.T_map_body[row]) @ T_map_body)


def map_of_world(saved: PriorMap) -> KnownMap:
    """A map that has the frame of the world, such as an imported one of its objects."""
    frame = np.eye(4)
    return KnownMap(saved, frame[None], frame[None], frame, 0.0)


def map_drive(records: Iterable[Record], config: Config) -> KnownMap:
    """Map a drive whose truth is known.

    Raises:
        SlamError: it cannot be mapped, or holds no truth.
    """
    slam = Slam(config)
    poses = list[GroundTruthPose]()
    for record in records:
        if isinstance(record, GroundTruthPose):
            poses.append(record)
        else:
            slam.process(record)
    final = slam.finish()
    estimate = clean_poses(final.trajectory.stamps_ns, final.trajectory.T_map_body)
    paired = synchronize(estimate, truth_of(poses), max_gap_s=MAX_TRUTH_GAP_S)
    alignment = align_path(paired.positions_est, paired.positions_gt)
    return KnownMap(
        saved=SavedMap(confirmed(final.object_map), final.graph),
        T_map_body=paired.T_map_body_est,
        T_world_body_gt=paired.T_world_body_gt,
        T_world_map=alignment.T_world_map,
        ate_m=compute_absolute_error(paired.positions_est, paired.positions_gt, alignment).rmse_m,
    )


def truth_of(records: Iterable[Record]) -> PoseSeries:
    """The true poses among records."""
    poses = [record for record in records if isinstance(record, GroundTruthPose)]
    return clean_poses(
        np.array([pose.stamp_ns for pose in poses], dtype=np.int64),
        np.array([pose.T_world_body for pose in poses]).reshape(-1, 4, 4),
    )
