"""The map at one time of the drive as messages for viewers; each holds its whole topic, so that a viewer may begin
anywhere.
"""

from collections.abc import Callable, Sequence

import numpy as np

from logs.messages import SceneLines, ScenePoints
from logs.scene import class_colors
from slam.backend.factor_graph import FactorGraph
from slam.common.arrays import FloatArray, IntArray
from slam.common.calibration import Calibration
from slam.common.geometry import apply, invert
from slam.display.map_topics import CLOSURES, LANDMARK_POINTS, MAP_FRAME, PATH, SUBMAP, Message
from slam.frontend.mapper import UPDATE_KEYFRAMES
from slam.object_map.landmarks import LandmarkState, ObjectMap
from slam.object_map.submap import recent_submap
from slam.odometry.keyframe import Keyframe


class SnapshotSchedule:
    """Schedule of the snapshots: each holds the whole map, so that one is due when a hundredth of the keyframes is new.

    ``first_keyframe``: the number of keyframes before the drive. One is due when the estimate has been brought up to
    date.
    """

    def __init__(self, first_keyframe: int) -> None:
        self._first = self._shown = first_keyframe

    def is_due(self, keyframes: int) -> bool:
        """Whether one is due now, and is taken, with so many keyframes."""
        is_updated = (keyframes - 1) % UPDATE_KEYFRAMES == 0
        if not is_updated or 100 * (keyframes - self._shown) <= keyframes - self._first:
            return False
        self._shown = keyframes
        return True


def take_snapshot(
    keyframes: Sequence[Keyframe],
    object_map: ObjectMap,
    graph: FactorGraph,
    closed: IntArray,
    is_localized: Callable[[Keyframe], bool],
    calibration: Calibration,
) -> list[Message]:
    """The map at the newest keyframe: the confirmed landmarks, those of the newest submap among them, the path of this
    drive, a line for each segment of the odometry, and the accepted closures.

    A stretch of odometry that nothing connects with the map has no place in it: neither its keyframes nor the
    landmarks that only it observed are here.

    Args:
        keyframes: all of them, those of a prior map first.
        object_map: their landmarks.
        graph: estimates both.
        closed: query and reference keyframe (C, 2) of the accepted closures.
        is_localized: whether odometry or closures connect a keyframe with the map.
        calibration: of the robot.
    """
    places = graph.poses()[:, :3, 3]
    segments = np.array([keyframe.odometry.segment for keyframe in keyframes])
    is_map_frame = np.array([keyframe.is_map_frame for keyframe in keyframes], dtype=np.bool_)
    closed = closed[~is_map_frame[closed].any(axis=1)]  # they would all lead to the origin of the map
    firsts = [keyframes[row] for row in np.unique(segments, return_index=True)[1].tolist()]
    connected = {first.odometry.segment: first for first in firsts if is_localized(first)}
    newest = keyframes[-1]
    placed = _placed(object_map, newest, graph.pose(newest.id))
    in_graph = graph.landmarks
    placed[in_graph] = graph.landmark_positions(in_graph)
    rows = object_map.in_state(LandmarkState.CONFIRMED)
    rows = rows[np.isin(object_map.rows["segment"][rows], list(connected)) & np.isfinite(placed[rows, 0])]
    stamp_ns, colors = newest.odometry.stamp_ns, class_colors(object_map.labels.classes(rows))
    is_submap = np.isin(rows, recent_submap(object_map, newest, calibration).rows)
    path = tuple(places[segments == segment] for segment, first in connected.items() if not first.is_prior)
    lines = places[closed[np.isin(segments[closed], list(connected)).all(axis=1)]]
    return [
        (LANDMARK_POINTS, ScenePoints(stamp_ns, MAP_FRAME, placed[rows], colors)),
        (SUBMAP, ScenePoints(stamp_ns, MAP_FRAME, placed[rows[is_submap]], np.ones((int(is_submap.sum()), 4)))),
        (PATH, SceneLines(stamp_ns, MAP_FRAME, path, (0.15, 0.45, 1.0, 1.0))),
        (CLOSURES, SceneLines(stamp_ns, MAP_FRAME, tuple(lines), (0.84, 0.15, 0.79, 0.9))),
    ]


def _placed(object_map: ObjectMap, newest: Keyframe, T_map_newest: FloatArray) -> FloatArray:
    """Positions (L, 3) of what is not in the graph: in the prior map, or around the robot; NaN where neither is so."""
    landmarks = object_map.rows
    positions = np.where(landmarks["position_map"].any(axis=1, keepdims=True), landmarks["position_map"], np.nan)
    around = landmarks["segment"] == newest.odometry.segment
    T_map_local = T_map_newest @ invert(newest.T_local_body)
    positions[around] = apply(T_map_local, landmarks["position_local"][around])
    return positions
