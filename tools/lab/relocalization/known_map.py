"""The map that a robot is searched in, and where its keyframes truly are."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np

from logs.messages import GroundTruthPose, Record
from slam.common.arrays import FloatArray
from slam.common.config import Config
from slam.common.geometry import invert
from slam.evaluation.inputs.protocol import Protocol
from slam.evaluation.inputs.synchronization import PoseSeries, series_of, synchronize
from slam.evaluation.metrics.trajectory import evaluate_trajectory
from slam.localization.prior_map import PriorMap
from slam.object_map.map_io import SavedMap, confirmed
from slam.place_recognition.imported_map import ImportedMap
from slam.system import Slam


@dataclass(frozen=True, slots=True, eq=False)
class KnownMap:
    """A map; ``positions`` (P, 3) m in the world are those of the robot that made it, else of its landmarks.

    ``T_map_body`` and ``T_world_body_gt`` (K, 4, 4): poses of the mapping drive, whose trajectory error is ``ate_m``;
    the identity for an imported map, which has the frame of the world.
    """

    saved: PriorMap
    positions: FloatArray
    T_map_body: FloatArray
    T_world_body_gt: FloatArray
    ate_m: float
    landmark_count: int

    def to_world(self, T_map_body: FloatArray, T_world_near: FloatArray) -> FloatArray:
        """A pose (4, 4) of the map in the world, by the pose of the mapping drive that is nearest to ``T_world_near``.

        The distortion of the map between distant places has no effect on it.
        """
        row = np.argmin(np.linalg.norm(self.T_world_body_gt[:, :2, 3] - T_world_near[:2, 3], axis=1))
        return np.asarray(self.T_world_body_gt[row] @ invert(self.T_map_body[row]) @ T_map_body)


def known_imported(imported: ImportedMap) -> KnownMap:
    """An imported map, whose frame is that of the world."""
    frame = np.eye(4)[None]
    return KnownMap(imported, imported.positions.astype(np.float64), frame, frame, 0.0, len(imported))


def map_drive(records: Iterable[Record], config: Config) -> KnownMap:
    """Map a drive whose truth is known.

    Raises:
        SlamError: it cannot be mapped, or holds no truth.
    """
    slam, poses = Slam(config), list[GroundTruthPose]()
    for record in records:
        if isinstance(record, GroundTruthPose):
            poses.append(record)
        else:
            slam.process(record)
    final = slam.finish()
    max_gap_s = Protocol().max_truth_gap_s
    estimate = series_of(zip(final.trajectory.stamps_ns.tolist(), final.trajectory.T_map_body, strict=True))
    est, gt = synchronize(estimate, truth_of(poses), max_gap_s=max_gap_s)
    return KnownMap(
        saved=SavedMap(confirmed(final.object_map), final.graph),
        positions=gt.positions,
        T_map_body=est.T_world_body,
        T_world_body_gt=gt.T_world_body,
        ate_m=evaluate_trajectory(estimate, truth_of(poses), max_gap_s=max_gap_s).ate_m,
        landmark_count=len(confirmed(final.object_map).ids),
    )


def truth_of(records: Iterable[Record]) -> PoseSeries:
    """The true poses among records."""
    return series_of((each.stamp_ns, each.T_world_body) for each in records if isinstance(each, GroundTruthPose))
