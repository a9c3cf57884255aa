"""Queries of global localization: what a sensor sees of a map, as the Descriptellation paper draws it."""

import numpy as np
from scipy.spatial import ConvexHull, QhullError

from logs.records import frozen
from slam.common.arrays import BoolArray, FloatArray, IntArray
from slam.common.errors import SimulationError
from slam.common.geometry import apply, invert, transform_from_xyz_yaw, travelled_m
from tools.lab.retrieval.labelled_map import LabelledMap


@frozen
class Scenario:
    """Differences of a query from the map (Section IV-B): visual range and, where ``noisy``, the noise as written.

    With noise a tenth of the objects is missed; an object is taken for another class with probability
    0.2 |p| / max |p|; every coordinate becomes ``p + |p| e`` with e ~ U(0, 0.1); the whole is scaled by U(0.9, 1.1).
    """

    name: str
    radius_m: float = 30.0
    noisy: bool = False


SCENARIOS = (Scenario("self"), Scenario("fewer objects", radius_m=20.0), Scenario("added noise", noisy=True))


@frozen
class LocalQuery:
    """Objects seen from one pose.

    ``positions`` (N, 3) m in the sensor's gravity frame, ``labels`` (N,) in the vocabulary of the map, ``objects`` (N,)
    which of the map they are, ``T_map_query_gt`` (4, 4).
    """

    positions: FloatArray
    labels: IntArray
    objects: IntArray
    T_map_query_gt: FloatArray


def draw_queries(
    objects: LabelledMap, tour: FloatArray, scenario: Scenario, *, count: int, rng: np.random.Generator
) -> list[LocalQuery]:
    """Queries at uniformly drawn points of a ``tour`` (M, 2) with a uniformly drawn yaw.

    Raises:
        SimulationError: no object is in sight of the tour.
    """
    along = travelled_m(tour)
    queries = []
    for _ in range(count):
        at = rng.uniform(0.0, along[-1])
        place = np.array([*(np.interp(at, along, axis) for axis in tour.T), 0.0])
        queries.append(_observe(objects, transform_from_xyz_yaw(place, rng.uniform(-np.pi, np.pi)), scenario, rng))
    if not any(len(query.labels) for query in queries):
        raise SimulationError(f"no object lies within {scenario.radius_m:g} m of the trajectory")
    return queries


def _observe(objects: LabelledMap, T_map_query: FloatArray, scenario: Scenario, rng: np.random.Generator) -> LocalQuery:
    offsets = objects.positions[:, :2] - T_map_query[:2, 3]
    near = np.flatnonzero(np.hypot(offsets[:, 0], offsets[:, 1]) < scenario.radius_m)
    if len(near):  # the sensor is among what it sees, however high that lies
        T_map_query[2, 3] = np.median(objects.positions[near, 2])
    seen = near[visible(offsets[near])]
    positions = apply(invert(T_map_query), objects.positions[seen])
    labels = objects.labels[seen]
    if scenario.noisy and len(seen):
        kept = rng.random(len(seen)) >= 0.1
        seen, positions, labels = seen[kept], positions[kept], labels[kept]
        ranges = np.linalg.norm(positions, axis=1)
        wrong = rng.random(len(labels)) < 0.2 * ranges / ranges.max(initial=1e-9)
        classes = len(objects.vocabulary)
        labels = np.where(wrong, (labels + rng.integers(1, max(classes, 2), len(labels))) % classes, labels)
        positions = positions + ranges[:, None] * rng.uniform(0.0, 0.1, positions.shape)
        positions = positions * rng.uniform(0.9, 1.1)
    return LocalQuery(positions, labels, seen, T_map_query)


def visible(offsets: FloatArray) -> BoolArray:
    """Which objects (N,) are not hidden, seen from the origin: hidden-point removal (Katz et al., SIGGRAPH 2007).

    In the plane, (N, 2) m: a point is visible if it lies on the convex hull of the viewpoint and all points after these
    were mirrored at a circle far out.
    """
    distances = np.hypot(offsets[:, 0], offsets[:, 1])
    everything = np.ones(len(offsets), dtype=np.bool_)
    if len(offsets) < 3 or not np.all(distances > 0.0):
        return everything
    radius = 100.0 * distances.max()
    flipped = offsets + 2.0 * (radius - distances)[:, None] * offsets / distances[:, None]
    try:
        hull = ConvexHull(np.vstack([flipped, np.zeros((1, 2))])).vertices
    except QhullError:
        return everything
    return np.isin(np.arange(len(offsets)), hull)
