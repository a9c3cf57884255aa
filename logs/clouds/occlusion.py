"""Which objects of a map can be seen from a place."""

from __future__ import annotations

import numpy as np

from logs.clouds.geometry import visible
from logs.clouds.objects import CloudObjects
from logs.messages import FloatArray, IntArray


def visible_objects(objects: CloudObjects, viewpoint: FloatArray, *, range_m: float) -> IntArray:
    """Rows (K,) of the objects within ``range_m`` of ``viewpoint`` (3,) m of which no other hides every voxel.

    As "Descriptellation" (Xing et al., V-B) makes its queries: by hidden-point removal (Katz et al., SIGGRAPH 2007).
    """
    near = np.flatnonzero(np.linalg.norm(objects.positions - viewpoint, axis=1) <= range_m)
    if not len(near):
        return near
    owner = np.repeat(near, [len(objects.voxels[row]) for row in near])
    seen = visible(np.concatenate([objects.voxels[row] for row in near]), viewpoint)
    return np.unique(owner[seen])
