"""A snapshot of the map as messages for viewers; each holds its whole topic, so that a viewer may begin anywhere."""

from __future__ import annotations

import numpy as np

from logs.messages import Record, SceneLines, ScenePoints
from logs.scene import class_colors
from slam.display.snapshot import MapSnapshot

MAP_FRAME = "map"
LANDMARKS, LANDMARK_POINTS, SUBMAP = "/slam/landmarks", "/slam/landmark_points", "/slam/submap"
PATH, CLOSURES = "/slam/path", "/slam/closure_lines"

Message = tuple[str, Record]
"""Topic and record."""


def map_messages(snapshot: MapSnapshot) -> list[Message]:
    """Landmarks as points, the submap among them, path and closures."""
    stamp_ns, positions = snapshot.stamp_ns, snapshot.positions
    is_submap = np.isin(snapshot.landmarks, snapshot.submap)
    white = np.tile((1.0, 1.0, 1.0, 1.0), (int(is_submap.sum()), 1))
    return [
        (LANDMARK_POINTS, ScenePoints(stamp_ns, MAP_FRAME, positions, class_colors(snapshot.classes))),
        (SUBMAP, ScenePoints(stamp_ns, MAP_FRAME, positions[is_submap], white)),
        (PATH, SceneLines(stamp_ns, MAP_FRAME, snapshot.path, (0.15, 0.45, 1.0, 1.0))),
        (CLOSURES, SceneLines(stamp_ns, MAP_FRAME, tuple(snapshot.closures), (0.84, 0.15, 0.79, 0.9))),
    ]
