"""Figures of a saved map."""

from typing import Any

import numpy as np
import pandas as pd

from slam.backend.edge_kind import EdgeKind
from slam.object_map.map_io import SavedMap, are_of_kind


def summarize_map(saved: SavedMap) -> dict[str, Any]:
    """The figures of a map that :func:`slam.object_map.map_io.load_map` has read, for JSON.

    ``classes``: the most frequent first; ``median_sigma_m``: of the standard deviations in the plane, a coordinate;
    ``closure_count``: factors of loop closures, those between drives included; ``width_m``, ``height_m``: extent of the
    landmarks along x and y of the map; ``path_m``: what the drives went, as far as it is in the map; ``drives``: inputs
    and versions, the first one first; ``stamp_ns``: when the last drive ended, on its own clock.
    """
    objects, graph = saved.objects, saved.graph
    sigmas_m = np.sqrt(np.trace(objects.covariances[:, :2, :2], axis1=1, axis2=2) / 2.0)
    of_classes = pd.DataFrame({"label": objects.labels, "sigma_m": sigmas_m}).groupby("label", as_index=False)[
        "sigma_m"
    ]
    classes = of_classes.agg(landmark_count="count", median_sigma_m="median")
    is_driven = are_of_kind(graph, EdgeKind.ODOMETRY)
    width_m, height_m = np.ptp(objects.positions[:, :2], axis=0).tolist()
    return {
        "landmark_count": len(objects.ids),
        "median_sigma_m": float(np.median(sigmas_m)),
        "classes": classes.sort_values("landmark_count", ascending=False, kind="stable").to_dict("records"),
        "keyframe_count": len(graph.keyframe_ids),
        "closure_count": int(np.count_nonzero(are_of_kind(graph, EdgeKind.LOOP_CLOSURE))),
        "observation_count": len(graph.observation_landmark_ids),
        "width_m": width_m,
        "height_m": height_m,
        "path_m": float(np.linalg.norm(graph.edge_transforms[is_driven, :3, 3], axis=1).sum()),
        "drives": [dict(drive) for drive in saved.drives],
        "stamp_ns": objects.stamp_ns,
    }
