"""The map at one time of the drive."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from slam.backend.factor_graph import FactorGraph
from slam.common.arrays import FloatArray, IntArray
from slam.common.calibration import Calibration
from slam.common.geometry import apply, invert
from slam.object_map.landmarks import LandmarkState, ObjectMap
from slam.object_map.submap import recent_submap
from slam.odometry.keyframe import Keyframe


class SnapshotSchedule:
    """Schedule of the snapshots: each holds the whole map, so that one is due when a hundredth of the keyframes is new.

    ``first_keyframe``: the number of keyframes before the drive; ``update_keyframes``: every so many bring the estimate
    up to date.
    """

    def __init__(self, first_keyframe: int, update_keyframes: int) -> None:
        self._first = self._shown = first_keyframe
        self._update_keyframes = update_keyframes

    def is_due(self, keyframes: int) -> bool:
        """Whether one is due now, and is taken, with so many keyframes."""
        is_updated = (keyframes - 1) % self._update_keyframes == 0
        if not is_updated or 100 * (keyframes - self._shown) <= keyframes - self._first:
            return False
        self._shown = keyframes
        return True


@dataclass(frozen=True, slots=True, eq=False)
class MapSnapshot:
    """Everything with a position in the map; positions in metres, map frame.

    A stretch of odometry that nothing connects with the map has no place in it: neither its keyframes nor the
    landmarks that only it observed are here.

    path: polylines (n, 3) through the keyframes of this drive, one for each segment of the odometry.
    closures: the two keyframes of each accepted closure, (C, 2, 3). landmarks (L,): ids of the confirmed ones,
    ascending, at positions (L, 3), of classes (L,), rows of the vocabulary. submap: which of them (S,) are in
    the submap of the newest keyframe.
    """

    stamp_ns: int
    path: tuple[FloatArray, ...]
    closures: FloatArray
    landmarks: IntArray
    positions: FloatArray
    classes: IntArray
    submap: IntArray


def take_snapshot(
    keyframes: Sequence[Keyframe],
    object_map: ObjectMap,
    graph: FactorGraph,
    closed: IntArray,
    is_localized: Callable[[Keyframe], bool],
    calibration: Calibration,
) -> MapSnapshot:
    """The map at the newest keyframe.

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
    first_of = {
        int(segment): int(first) for segment, first in zip(*np.unique(segments, return_index=True), strict=True)
    }
    connected = [segment for segment, first in first_of.items() if is_localized(keyframes[first])]
    newest = keyframes[-1]
    placed = _placed(object_map, newest, graph.pose(newest.id))
    in_graph = graph.landmarks
    placed[in_graph] = graph.landmark_positions(in_graph)
    rows = object_map.in_state(LandmarkState.CONFIRMED)
    rows = rows[np.isin(object_map.rows["segment"][rows], connected) & np.isfinite(placed[rows, 0])]
    own = [segment for segment in connected if not keyframes[first_of[segment]].is_prior]
    return MapSnapshot(
        stamp_ns=newest.odometry.stamp_ns,
        path=tuple(places[segments == segment] for segment in own),
        closures=places[closed[np.isin(segments[closed], connected).all(axis=1)]],
        landmarks=rows,
        positions=placed[rows],
        classes=object_map.labels.classes(rows),
        submap=np.intersect1d(recent_submap(object_map, newest, calibration).rows, rows),
    )


def _placed(object_map: ObjectMap, newest: Keyframe, T_map_newest: FloatArray) -> FloatArray:
    """Positions (L, 3) of what is not in the graph: in the prior map, or around the robot; NaN where neither is so."""
    landmarks = object_map.rows
    positions = np.where(landmarks["position_map"].any(axis=1, keepdims=True), landmarks["position_map"], np.nan)
    around = landmarks["segment"] == newest.odometry.segment
    T_map_local = T_map_newest @ invert(newest.T_local_body)
    positions[around] = apply(T_map_local, landmarks["position_local"][around])
    return np.asarray(positions)
