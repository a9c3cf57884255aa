"""Two maps of one place become one map.

The second map is driven through once more, keyframe by keyframe, with what each observed: a drive in the first map
whose odometry is the second map. Relocalization, closures and fusion of landmarks are those of any drive in a map.
"""

from __future__ import annotations

import logging
from collections import defaultdict
from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from pydantic import ValidationError
from scipy.spatial import cKDTree

from slam.backend.factor_graph import FactorGraph
from slam.backend.factors import Edge, EdgeKind
from slam.backend.solver_options import FactorGraphConfig
from slam.common.arrays import FloatArray, IntArray
from slam.common.config import Config
from slam.common.geometry import apply, invert
from slam.localization.prior_map import STAMP_NS, restore, restore_graph
from slam.loop_closure.landmark_fusion import fuse_duplicate_landmarks
from slam.loop_closure.loop_closer import LoopCloser
from slam.object_map.landmarks import LandmarkState, ObjectMap
from slam.object_map.map_io import SavedMap, confirmed, observing
from slam.odometry.keyframe import Keyframe
from slam.odometry.noise import BREAK_SIGMA_RAD, BREAK_SIGMA_RANGES
from slam.odometry.pose import OdometryPose
from slam.place_recognition.imported_places import SEGMENT

logger = logging.getLogger(__name__)


@dataclass(frozen=True, slots=True, eq=False)
class MergedMap:
    """A map in the frame of the first of two.

    ``recognised``: keyframes of the second map that were recognised in the first one; 0 if only the georeferences
    relate the two. ``shared``: landmarks that were in both.
    """

    saved: SavedMap
    recognised: int
    shared: int


def merge_maps(first: SavedMap, second: SavedMap, progress: Callable[[float], None] | None = None) -> MergedMap | None:
    """Join two maps by recognising places of the second in the first, or else by the georeferences of both.

    Returns:
        The joined map; None if no place is recognised and not both maps are georeferenced.
    """
    merging = _Merging(first, second)
    recognised = merging.recognise(progress)
    if not recognised:
        T_first_second = _relative_georeference(first, second)
        if T_first_second is None:
            return None
        merging = _Merging(first, moved(second, T_first_second), kind=EdgeKind.LOOP_CLOSURE)
    return merging.finish(recognised)


def _configuration(saved: SavedMap) -> Config:
    """That of the last drive in a map; the default one if it is not known, or has settings that there are no longer."""
    try:
        return Config.model_validate_json(saved.metadata.get("configuration", "{}"))
    except ValidationError as error:
        logger.info("the default configuration is used: %s", error)
        return Config()


def _relative_georeference(first: SavedMap, second: SavedMap) -> FloatArray | None:
    """``T_first_second`` (4, 4); None if one of them is not georeferenced."""
    if first.georeference is None or second.georeference is None:
        return None
    return first.georeference.T_map_other(second.georeference)


def moved(saved: SavedMap, T_new_old: FloatArray) -> SavedMap:
    """The map in another frame."""
    R = T_new_old[:3, :3]
    return replace(
        saved,
        objects=replace(
            saved.objects,
            positions=apply(T_new_old, saved.objects.positions),
            covariances=R @ saved.objects.covariances @ R.T,
        ),
        graph=replace(saved.graph, T_map_body=T_new_old @ saved.graph.T_map_body),
    )


class _Merging:
    """The second map as a second segment beside the first one."""

    def __init__(self, first: SavedMap, second: SavedMap, kind: EdgeKind = EdgeKind.DISCONTINUITY) -> None:
        self._maps = first, second
        config, T = _configuration(first), second.graph.T_map_body
        steps_m = np.linalg.norm(np.diff(T[:, :3, 3], axis=0), axis=1)
        self._travel_m = np.concatenate([[0.0], np.cumsum(steps_m)])
        # So long is no way to anywhere in the second map itself: its own loops are closed.
        no_return_m = max(float(self._travel_m[-1]) + 1.0, config.closure_travel_m)
        limits = config.loop_closure.model_copy(update={"min_travel_m": no_return_m})
        self._config = config = config.model_copy(update={"loop_closure": limits})
        sensor_range_m = config.sensor_range_m
        self._object_map = ObjectMap(config.calibration.objects)
        self._graph = FactorGraph(FactorGraphConfig(), sensor_range_m=sensor_range_m)
        self._keyframes = restore(first, self._object_map, self._graph, fixed=False)
        self._count = len(self._keyframes)
        self._rows = self._object_map.restore(second.objects, travel_m=np.inf)
        landmarks = self._object_map.rows
        landmarks["segment"][self._rows] = SEGMENT + 1
        landmarks["state"][self._rows] = LandmarkState.TENTATIVE  # until the drive comes to it
        numbers = range(self._count, self._count + len(T))
        row_of = dict(zip(second.objects.ids, self._rows.tolist(), strict=True))
        sigmas = np.repeat([BREAK_SIGMA_RAD, BREAK_SIGMA_RANGES * sensor_range_m], 3)
        T_last_next = invert(first.graph.T_map_body[-1]) @ T[0]
        tie = Edge(self._count - 1, self._count, T_last_next, np.diag(sigmas**2), kind)
        restore_graph(second, self._graph, numbers, row_of, tie)
        self._closer = LoopCloser(config, self._object_map, self._graph, self._keyframes)
        self._seen = defaultdict[int, list[int]](list)
        for keyframe, name in zip(
            second.graph.observation_keyframe_ids.tolist(), second.graph.observation_landmark_ids, strict=True
        ):
            self._seen[keyframe].append(row_of[name])

    def recognise(self, progress: Callable[[float], None] | None) -> int:
        """Drive through the second map; returns how many of its keyframes were recognised in the first one."""
        graph = self._maps[1].graph
        for row, (number, T) in enumerate(zip(graph.keyframe_ids.tolist(), graph.T_map_body, strict=True)):
            pose = OdometryPose(STAMP_NS, T, float(self._travel_m[row]), SEGMENT + 1, np.inf)
            keyframe = Keyframe(self._count + row, pose, T)
            self._keyframes.append(keyframe)
            self._see(np.unique(np.array(self._seen[number], dtype=np.int64)), pose.travel_m)
            self._closer.close(keyframe)
            if self._closer.lost_since_keyframe is not None:
                self._closer.declare_lost(keyframe, self._closer.lost_since_keyframe)
            if progress is not None:
                progress((row + 1) / len(graph.keyframe_ids))
        return len(self._closer.closures.keyframes)

    def _see(self, rows: IntArray, travel_m: float) -> None:
        landmarks = self._object_map.rows
        new = rows[landmarks["state"][rows] == LandmarkState.TENTATIVE]
        landmarks["first_seen_travel_m"][new] = travel_m
        landmarks["last_seen_travel_m"][rows] = travel_m
        self._object_map.confirm(new)

    def finish(self, recognised: int) -> MergedMap:
        """Fuse what is twice in the map, optimise and hand out the result."""
        first, second = self._maps
        self._object_map.confirm(self._object_map.in_state(LandmarkState.TENTATIVE))
        nearby = self._closer.closures.keyframes_nearby() if recognised else set(self._graph.keyframes.tolist())
        radius_m = 2.0 * self._config.calibration.objects.landmark_sigma_m
        fuse_duplicate_landmarks(self._object_map, self._graph, nearby, radius_m=radius_m)
        self._graph.optimize()
        self._place_landmarks()
        objects = confirmed(self._object_map.to_record(second.objects.stamp_ns))
        stamps_ns = np.concatenate([first.graph.keyframe_stamps_ns, second.graph.keyframe_stamps_ns])
        graph = self._graph.to_record(second.objects.stamp_ns, stamps_ns)
        graph = observing(graph, objects, np.ones(len(stamps_ns), dtype=np.bool_))
        metadata = dict(second.metadata)
        metadata.pop("georeference", None)
        if "georeference" in first.metadata:
            metadata["georeference"] = first.metadata["georeference"]
        saved = SavedMap(objects, graph, metadata, (*first.drives, *second.drives))
        return MergedMap(saved, recognised, len(first.objects.ids) + len(second.objects.ids) - len(objects.ids))

    def _place_landmarks(self) -> None:
        """Landmarks are where the graph has them; others move as the nearest keyframe does."""
        landmarks, second = self._object_map.rows, self._maps[1]
        T_old = second.graph.T_map_body
        T_new = self._graph.poses()[self._count :]
        near = cKDTree(T_old[:, :3, 3]).query(second.objects.positions)[1]
        shift = (T_new @ invert(T_old))[near]
        R = shift[:, :3, :3]
        landmarks["position_map"][self._rows] = np.einsum("nij,nj->ni", R, second.objects.positions) + shift[:, :3, 3]
        landmarks["covariance_map"][self._rows] = R @ second.objects.covariances @ np.swapaxes(R, 1, 2)
        in_graph = self._graph.landmarks
        landmarks["position_map"][in_graph] = self._graph.landmark_positions(in_graph)
        landmarks["covariance_map"][in_graph] = self._graph.landmark_covariances(in_graph)
