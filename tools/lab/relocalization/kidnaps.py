"""Places that a robot is kidnapped to, and how the world and its sensor differ there from when the map was made."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from scipy.spatial import cKDTree

from slam.common.arrays import FloatArray
from slam.common.errors import SimulationError
from slam.simulation.config import SensorConfig
from slam.simulation.world import World

BESIDE_M = (3.0, 15.0)
"""How far off the tour new objects stand."""
SPACING_M = 1.0


@dataclass(frozen=True, slots=True, eq=False)
class Kidnap:
    """A short drive from a place ``start_m`` along the tour: ``tour`` (M, 2) m, along the long one or against it."""

    number: int
    start_m: float
    is_along: bool
    tour: FloatArray


def draw_kidnaps(tour: FloatArray, *, count: int, length_m: float, rng: np.random.Generator) -> list[Kidnap]:
    """Pieces of ``length_m`` of a ``tour`` (M, 2) m, uniformly drawn, each driven in one direction or the other.

    They lie on the tour as a whole; a tour shorter than that is driven from end to end.

    Raises:
        SimulationError: no kidnapping, or a tour or length of zero.
    """
    along_m = _along_m(tour)
    if count < 1 or not (length_m > 0.0 and along_m[-1] > 0.0):
        raise SimulationError(
            f"{count} drives of {length_m:g} m on a tour of {along_m[-1]:g} m; each of these must be above 0"
        )
    length_m = min(length_m, float(along_m[-1]))
    first_m = rng.uniform(0.0, along_m[-1] - length_m, count)
    is_along = rng.random(count) < 0.5
    return [
        Kidnap(
            number=number,
            start_m=begin if forward else begin + length_m,
            is_along=forward,
            tour=_piece(tour, along_m, begin, begin + length_m)[:: 1 if forward else -1],
        )
        for number, (begin, forward) in enumerate(zip(first_m.tolist(), is_along.tolist(), strict=True))
    ]


def thin_world(world: World, factor: float, *, rng: np.random.Generator) -> World:
    """The same world with one of ``factor`` objects, drawn at random and at least one.

    Raises:
        SimulationError: ``factor`` is below 1.
    """
    if not factor >= 1.0:
        raise SimulationError(f"one of {factor:g} objects; give a factor of at least 1")
    if factor == 1.0:
        return world
    count = len(world.labels)
    kept = np.sort(rng.choice(count, max(round(count / factor), 1), replace=False))
    return replace(
        world,
        name=f"{world.name}, one of {factor:g} objects",
        object_ids=tuple(world.object_ids[row] for row in kept),
        positions=world.positions[kept],
        labels=tuple(world.labels[row] for row in kept),
    )


def change_world(world: World, share: float, *, reach_m: float, rng: np.random.Generator) -> World:
    """The world after a while: that ``share`` of the objects within ``reach_m`` of the tour is replaced.

    They are gone, and as many others stand 3 m to 15 m off the tour elsewhere, with heights and classes that are as
    frequent as in the world.

    Raises:
        SimulationError: ``share`` is not in [0, 1].
    """
    if not 0.0 <= share <= 1.0:
        raise SimulationError(f"a share of {share:g} of the objects changed; give 0 to 1")
    points, normals = _beside(world.tour)
    near = np.flatnonzero(cKDTree(points).query(world.positions[:, :2])[0] <= reach_m)
    gone = rng.choice(near, round(share * len(near)), replace=False)
    if not len(gone):
        return world
    at = rng.integers(len(points), size=len(gone))
    off_m = rng.uniform(*BESIDE_M, len(gone)) * rng.choice([-1.0, 1.0], len(gone))
    like = rng.integers(len(world.labels), size=len(gone))
    kept = np.setdiff1d(np.arange(len(world.labels)), gone)
    new = np.column_stack([points[at] + off_m[:, None] * normals[at], world.positions[like, 2]])
    return replace(
        world,
        name=f"{world.name}, changed",
        object_ids=(*(world.object_ids[row] for row in kept), *(f"new object {row}" for row in range(len(gone)))),
        positions=np.concatenate([world.positions[kept], new]),
        labels=tuple(world.labels[row] for row in (*kept, *like)),
    )


def worsen(sensor: SensorConfig, factor: float) -> SensorConfig:
    """The same sensor, ``factor`` times as wrong: about where and what objects are, which it misses and invents."""
    worse = {
        "noise_base_m": factor * sensor.noise_base_m,
        "noise_per_m": factor * sensor.noise_per_m,
        "dropout": min(factor * sensor.dropout, 1.0),
        "false_positives_per_scan": factor * sensor.false_positives_per_scan,
        "misclassification": min(factor * sensor.misclassification, 1.0),
    }
    return SensorConfig.model_validate(sensor.model_dump() | worse)


def _along_m(tour: FloatArray) -> FloatArray:
    return np.append(0.0, np.cumsum(np.linalg.norm(np.diff(tour, axis=0), axis=1)))


def _piece(tour: FloatArray, along_m: FloatArray, from_m: float, to_m: float) -> FloatArray:
    ends = np.column_stack([np.interp([from_m, to_m], along_m, tour[:, axis]) for axis in (0, 1)])
    return np.vstack([ends[:1], tour[(along_m > from_m) & (along_m < to_m)], ends[1:]])


def _beside(tour: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Points (K, 2) in even steps along the tour, and the unit vectors (K, 2) to their left."""
    along_m = _along_m(tour)
    at_m = np.linspace(0.0, along_m[-1], 2 + int(along_m[-1] / SPACING_M))
    points = np.column_stack([np.interp(at_m, along_m, tour[:, axis]) for axis in (0, 1)])
    ahead = np.gradient(points, axis=0)
    ahead /= np.maximum(np.linalg.norm(ahead, axis=1, keepdims=True), 1e-9)
    return points, np.column_stack([-ahead[:, 1], ahead[:, 0]])
