"""A pose graph: poses, and the edges between them; plain arrays that know no solver and no file."""

from __future__ import annotations

from dataclasses import dataclass

from slam.common.arrays import FloatArray, IntArray


@dataclass(frozen=True, slots=True, eq=False)
class PoseGraph:
    """Poses ``T_world_vertex`` (V, 4, 4) in metres, of which the first stays where it is.

    edges (E, 2): the rows (from, to) of each; T_from_to (E, 4, 4); covariances (E, 6, 6), rotation before translation.
    """

    T_world_vertex: FloatArray
    edges: IntArray
    T_from_to: FloatArray
    covariances: FloatArray
