"""Random maps to train on: objects in lines, circles and clusters.

Xing et al., Descriptellation: Deep Learned Constellation Descriptors, Section III-E. The paper names the patterns and
the kinds of distributions but none of the ranges; those here are ours.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

KINDS = ("line", "circle", "cluster")


@dataclass(frozen=True, slots=True)
class MapSimulation:
    """Ranges of the random maps, both ends included.

    The paper's: three kinds of patterns; numbers of patterns, of objects in each and labels from discrete uniform
    distributions; the places of the patterns from a continuous uniform distribution. Ours: every number, chosen so that
    constellations with a radius of 30 m have 18 objects in the median and three quarters of them 10 to 30; uniform
    sizes and headings of the patterns; even steps along lines and circles, which lie flat; normal heights.

    ``patterns``, ``objects_per_pattern``: how many. ``classes``: how many a map has, drawn anew for every map from
    ``vocabulary_size``, so that what a class means cannot be learned. ``uniform_pattern_share``: of the patterns, how
    many repeat one label, as the lamps of a row do; the paper has none. ``side_m``: of the square of the patterns'
    middles. ``line_step_m``: between neighbours of a line. ``cluster_sigma_m``: along either axis of a cluster.
    """

    patterns: tuple[int, int] = (16, 24)
    objects_per_pattern: tuple[int, int] = (3, 9)
    classes: tuple[int, int] = (8, 30)
    vocabulary_size: int = 64
    kinds: tuple[str, ...] = KINDS
    uniform_pattern_share: float = 0.0
    side_m: float = 140.0
    line_step_m: tuple[float, float] = (4.0, 12.0)
    circle_radius_m: tuple[float, float] = (4.0, 20.0)
    cluster_sigma_m: tuple[float, float] = (3.0, 15.0)
    height_sigma_m: float = 1.5


@dataclass(frozen=True, slots=True, eq=False)
class SimulatedMap:
    """N objects: ``positions`` (N, 3) m, gravity along z, and ``labels`` (N,), ids below the vocabulary's size."""

    positions: NDArray[np.float64]
    labels: NDArray[np.int64]


def simulate_map(simulation: MapSimulation, *, rng: np.random.Generator) -> SimulatedMap:
    """A map of superimposed patterns with labels that mean nothing (Section III-E)."""
    count = int(rng.integers(*simulation.classes, endpoint=True))
    classes = rng.permutation(simulation.vocabulary_size)[:count]
    plans, labels = [], []
    for _ in range(int(rng.integers(*simulation.patterns, endpoint=True))):
        size = int(rng.integers(*simulation.objects_per_pattern, endpoint=True))
        heading = np.exp(1j * rng.uniform(-np.pi, np.pi))
        plans.append(complex(*rng.uniform(0.0, simulation.side_m, 2)) + heading * _pattern(simulation, size, rng))
        is_uniform = rng.random() < simulation.uniform_pattern_share
        labels.append(np.full(size, rng.choice(classes)) if is_uniform else rng.choice(classes, size=size))
    plan = np.concatenate(plans)
    heights = rng.normal(scale=simulation.height_sigma_m, size=len(plan))
    return SimulatedMap(np.column_stack([plan.real, plan.imag, heights]), np.concatenate(labels).astype(np.int64))


def _pattern(simulation: MapSimulation, size: int, rng: np.random.Generator) -> NDArray[np.complex128]:
    """Horizontal places (size,), x + iy in metres about the middle, of one pattern of any kind."""
    numbers = np.arange(size)
    match simulation.kinds[rng.integers(len(simulation.kinds))]:
        case "line":
            return np.asarray((numbers - (size - 1) / 2.0) * (1.0 + 0.0j) * rng.uniform(*simulation.line_step_m))
        case "circle":
            return np.asarray(rng.uniform(*simulation.circle_radius_m) * np.exp(2j * np.pi * numbers / size))
        case _:
            x, y = rng.uniform(*simulation.cluster_sigma_m, (2, 1)) * rng.normal(size=(2, size))
            return np.asarray(x + 1j * y)
