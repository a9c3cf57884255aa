"""Keyframes: the poses of the odometry that the factor graph estimates."""

from __future__ import annotations

from dataclasses import dataclass

from slam.odometry.track import OdometryPose


@dataclass(frozen=True, slots=True, eq=False)
class Keyframe:
    """A pose of the track that the graph knows."""

    id: int
    odometry: OdometryPose
