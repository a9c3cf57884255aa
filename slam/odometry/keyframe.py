"""Keyframes: the poses of the odometry that the factor graph estimates."""

from __future__ import annotations

from dataclasses import dataclass

from slam.common.arrays import FloatArray
from slam.odometry.pose import OdometryPose


@dataclass(frozen=True, slots=True, eq=False)
class Keyframe:
    """A pose of the track that the graph knows; ``T_local_body`` (4, 4): where landmarks around have it, see
    :mod:`slam.frontend.local_map`.

    ``is_prior``: a keyframe of a prior map. Its ``odometry`` holds its pose in that map, and no travel, time or speed.
    ``is_map_frame``: it stands for the frame of a map without keyframes, the reference wherever in it.
    """

    id: int
    odometry: OdometryPose
    T_local_body: FloatArray
    is_prior: bool = False
    is_map_frame: bool = False
