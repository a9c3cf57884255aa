"""What a saved map holds, in numbers."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from logs.container.json_text import parse_json
from slam.backend.edge_kind import EdgeKind
from slam.object_map.map_io import SavedMap, are_of_kind


@dataclass(frozen=True, slots=True)
class ClassSummary:
    """Landmarks of one class; ``median_sigma_m``: of their standard deviations in the plane, a coordinate."""

    label: str
    landmark_count: int
    median_sigma_m: float


@dataclass(frozen=True, slots=True)
class MapSummary:
    """A saved map at a glance.

    ``classes``: the most frequent first. ``closure_count``: factors of loop closures, those between drives included;
    ``width_m``, ``height_m``: extent of the landmarks along x and y of the map; ``path_m``: what the drives went, as
    far as it is in the map; ``drives``: inputs and versions, the first one first; ``descriptor``: that of the last
    drive's configuration, empty if it is not known; ``stamp_ns``: when the last drive ended, on its own clock.
    """

    format_version: str
    gravity: str
    landmark_count: int
    median_sigma_m: float
    classes: tuple[ClassSummary, ...]
    vocabulary_size: int
    keyframe_count: int
    odometry_edge_count: int
    closure_count: int
    observation_count: int
    width_m: float
    height_m: float
    path_m: float
    drives: tuple[dict[str, str], ...]
    descriptor: str
    stamp_ns: int


def summarize_map(saved: SavedMap) -> MapSummary:
    """The summary of a map that :func:`slam.object_map.map_io.load_map` has read."""
    objects, graph = saved.objects, saved.graph
    sigmas_m = np.sqrt(np.trace(objects.covariances[:, :2, :2], axis1=1, axis2=2) / 2.0)
    labels = np.array(objects.labels)
    names, counts = np.unique(labels, return_counts=True)
    order = np.lexsort((names, -counts))
    is_closure = are_of_kind(graph, EdgeKind.LOOP_CLOSURE)
    is_driven = are_of_kind(graph, EdgeKind.ODOMETRY)
    width_m, height_m = np.ptp(objects.positions[:, :2], axis=0).tolist()
    return MapSummary(
        format_version=saved.metadata.get("format_version", ""),
        gravity=saved.metadata.get("gravity", ""),
        landmark_count=len(objects.ids),
        median_sigma_m=float(np.median(sigmas_m)),
        classes=tuple(
            ClassSummary(str(names[row]), int(counts[row]), float(np.median(sigmas_m[labels == names[row]])))
            for row in order
        ),
        vocabulary_size=len(objects.vocabulary),
        keyframe_count=len(graph.keyframe_ids),
        odometry_edge_count=int(np.count_nonzero(is_driven)),
        closure_count=int(np.count_nonzero(is_closure)),
        observation_count=len(graph.observation_landmark_ids),
        width_m=width_m,
        height_m=height_m,
        path_m=float(np.linalg.norm(graph.edge_transforms[is_driven, :3, 3], axis=1).sum()),
        drives=tuple(dict(drive) for drive in saved.drives),
        descriptor=_descriptor(saved.metadata.get("configuration", "")),
        stamp_ns=objects.stamp_ns,
    )


def _descriptor(configuration: str) -> str:
    try:
        return str(parse_json(configuration)["loop_closure"]["descriptor"])
    except (ValueError, KeyError, TypeError):
        return ""
