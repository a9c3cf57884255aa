"""Queries of a kidnapped robot: what it has observed on a straight path anywhere in a map of objects."""

from dataclasses import fields
from typing import Annotated

import numpy as np
from pydantic import ConfigDict, Field, TypeAdapter
from scipy.spatial import cKDTree

from logs.records import frozen
from slam.common.arrays import FloatArray, IntArray
from slam.common.config import SUBMAP_RANGES
from slam.common.errors import SimulationError
from slam.common.geometry import apply, invert, transform_from_xyz_yaw
from slam.object_map.submap import Submap
from tools.lab.retrieval.labelled_map import LabelledMap


@frozen
class Scenario:
    """Differences of a query from the map.

    ``missing``: share of the objects in range that are not observed; ``clutter``: share of the observed ones that the
    map does not have; ``noise_m``: standard deviation of each coordinate. ``objects``: number of objects, those nearest
    to the robot after as much travel as it takes; 0: all within range on the travel of a submap. ``range_m`` of the
    sensor.
    """

    objects: Annotated[int, Field(ge=0)] = 0
    missing: Annotated[float, Field(ge=0.0, le=0.9)] = 0.1
    clutter: Annotated[float, Field(ge=0.0, le=0.9)] = 0.1
    noise_m: Annotated[float, Field(ge=0.0)] = 0.2
    range_m: Annotated[float, Field(ge=1.0)] = 30.0
    __pydantic_config__ = ConfigDict(extra="forbid")


def parse_scenario(text: str) -> Scenario:
    """The scenario of a text like "objects=20,missing=0.3"; what it leaves out is as in the default one.

    Raises:
        SimulationError: another form, or a value that is not allowed.
    """
    try:
        return TypeAdapter(Scenario).validate_python(dict(part.split("=") for part in text.split(",") if part))
    except ValueError as error:
        names = ", ".join(each.name for each in fields(Scenario))
        raise SimulationError(f"query {text!r}: give NAME=NUMBER of {names}, e.g. objects=20,missing=0.3") from error


@frozen
class PathQuery:
    """``submap`` in the frame of the robot, and where it is, ``T_map_query_gt`` (4, 4)."""

    submap: Submap
    T_map_query_gt: FloatArray


def draw_path_queries(
    objects: LabelledMap, count: int, scenario: Scenario, *, rng: np.random.Generator
) -> list[PathQuery]:
    """Queries from straight paths that begin at objects of the map, in any direction.

    Args:
        objects: the map.
        count: how many queries.
        scenario: how they differ from the map.
        rng: draws the paths and what is observed.

    Raises:
        SimulationError: objects so sparse that too few paths pass enough of them.
    """
    tree, fewest = cKDTree(objects.positions[:, :2]), scenario.objects or 8
    drawn: list[PathQuery] = []
    for _ in range(100 * count):
        if len(drawn) == count:
            return drawn
        begin, yaw = objects.positions[rng.integers(len(objects))], rng.uniform(-np.pi, np.pi)
        seen, end = _drive(tree, begin[:2], yaw, scenario, rng)
        if len(seen) < fewest:
            continue
        place = np.array([*end, np.median(objects.positions[seen, 2])])
        T_map_query = transform_from_xyz_yaw(place, yaw)
        local = apply(invert(T_map_query), objects.positions[seen])
        drawn.append(PathQuery(_observe(local, objects.labels[seen], scenario, rng), T_map_query))
    raise SimulationError(f"too few paths pass {fewest} objects within {scenario.range_m:g} m; give a denser map")


def _drive(
    tree: cKDTree, begin: FloatArray, yaw: float, scenario: Scenario, rng: np.random.Generator
) -> tuple[IntArray, FloatArray]:
    """Objects (K,), ascending, that are observed on a path from ``begin`` (2,) m, and where it ends (2,) m."""
    range_m = scenario.range_m
    submap_m, step_m = SUBMAP_RANGES * range_m, range_m / 6.0
    # A robot that has not seen the objects by then gives up.
    travel_m = 10 * submap_m if scenario.objects else submap_m
    path = begin + np.arange(0.0, travel_m + 0.5 * step_m, step_m)[:, None] * np.array([np.cos(yaw), np.sin(yaw)])
    in_range = [np.asarray(rows, dtype=np.int64) for rows in tree.query_ball_point(path, range_m)]
    rows, first_step = np.unique(np.concatenate(in_range), return_index=True)
    first_step = np.repeat(np.arange(len(path)), [len(each) for each in in_range])[first_step]
    is_observed = rng.random(len(rows)) >= scenario.missing
    rows, first_step = rows[is_observed], first_step[is_observed]
    if not scenario.objects or len(rows) < scenario.objects:
        return rows, path[-1]
    last = np.partition(first_step, scenario.objects - 1)[scenario.objects - 1]
    rows = rows[first_step <= last]
    offsets = tree.data[rows] - path[last]
    nearest = np.argsort(np.hypot(offsets[:, 0], offsets[:, 1]), kind="stable")[: scenario.objects]
    return np.sort(rows[nearest]), path[last]


def _observe(local: FloatArray, labels: IntArray, scenario: Scenario, rng: np.random.Generator) -> Submap:
    """The objects at ``local`` (N, 3) m, some of which are clutter elsewhere instead, with noise."""
    clutter = rng.choice(len(local), rng.binomial(len(local), scenario.clutter), replace=False)
    local[clutter, :2] = rng.uniform(local[:, :2].min(axis=0), local[:, :2].max(axis=0), (len(clutter), 2))
    local[:, :2] += rng.normal(0.0, scenario.noise_m, (len(local), 2))
    return Submap(local, np.full(len(local), scenario.noise_m), labels, np.arange(len(local)))
