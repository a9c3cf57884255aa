"""Random maps to train on: objects in lines, circles and clusters.

Xing et al., Descriptellation: Deep Learned Constellation Descriptors, Section III-E. The paper names the patterns and
the kinds of distributions but none of the ranges; those here are ours.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal, get_args

import numpy as np
from numpy.typing import NDArray

from descriptors.errors import DescriptorError

PatternKind = Literal["line", "circle", "cluster"]


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

    Raises:
        DescriptorError: a range that is empty or leaves its bounds.
    """

    patterns: tuple[int, int] = (16, 24)
    objects_per_pattern: tuple[int, int] = (3, 9)
    classes: tuple[int, int] = (8, 30)
    vocabulary_size: int = 64
    kinds: tuple[PatternKind, ...] = get_args(PatternKind)
    uniform_pattern_share: float = 0.0
    side_m: float = 140.0
    line_step_m: tuple[float, float] = (4.0, 12.0)
    circle_radius_m: tuple[float, float] = (4.0, 20.0)
    cluster_sigma_m: tuple[float, float] = (3.0, 15.0)
    height_sigma_m: float = 1.5

    def __post_init__(self) -> None:
        _check_range("patterns", self.patterns, lowest=1)
        _check_range("objects_per_pattern", self.objects_per_pattern, lowest=1)
        _check_range("classes", self.classes, lowest=1)
        for name in ("line_step_m", "circle_radius_m", "cluster_sigma_m"):
            _check_range(name, getattr(self, name), lowest=0)
        if self.classes[1] > self.vocabulary_size:
            raise DescriptorError(
                f"{self.classes[1]} classes of a vocabulary of {self.vocabulary_size}; lower classes or raise "
                "vocabulary_size"
            )
        unknown = set(self.kinds) - set(get_args(PatternKind))
        if unknown or not self.kinds:
            raise DescriptorError(f"kinds {self.kinds}; give at least one of {get_args(PatternKind)} and no other")


@dataclass(frozen=True, slots=True, eq=False)
class SimulatedMap:
    """N objects: ``positions`` (N, 3) m, gravity along z, and ``labels`` (N,), ids below the vocabulary's size."""

    positions: NDArray[np.float64]
    labels: NDArray[np.int64]


def simulate_map(simulation: MapSimulation, *, rng: np.random.Generator) -> SimulatedMap:
    """A map of superimposed patterns with labels that mean nothing (Section III-E)."""
    pattern_count = _draw_count(simulation.patterns, rng=rng)
    low, high = simulation.objects_per_pattern
    sizes = rng.integers(low, high, size=pattern_count, endpoint=True)
    plan = _draw_plan(simulation, sizes, rng=rng)
    heights = rng.normal(scale=simulation.height_sigma_m, size=len(plan))
    return SimulatedMap(np.column_stack([plan, heights]), _draw_labels(simulation, sizes, rng=rng))


def _draw_plan(simulation: MapSimulation, sizes: NDArray[np.int64], *, rng: np.random.Generator) -> NDArray[np.float64]:
    """Horizontal coordinates (N, 2) m of the objects of P patterns with ``sizes`` (P,) objects each."""
    patterns, numbers = _members(sizes)
    shapes = {
        "line": _draw_line(simulation, sizes, rng=rng),
        "circle": _draw_circle(simulation, sizes, rng=rng),
        "cluster": _draw_cluster(simulation, sizes, rng=rng),
    }
    allowed = np.stack([shapes[kind] for kind in simulation.kinds])
    kinds = rng.integers(len(simulation.kinds), size=len(sizes))
    relative = allowed[kinds[patterns], np.arange(len(numbers))]
    headings = rng.uniform(-np.pi, np.pi, size=len(sizes))[patterns]
    cosines, sines = np.cos(headings), np.sin(headings)
    turned = np.column_stack(
        [cosines * relative[:, 0] - sines * relative[:, 1], sines * relative[:, 0] + cosines * relative[:, 1]]
    )
    middles = rng.uniform(0.0, simulation.side_m, size=(len(sizes), 2))
    return np.asarray(middles[patterns] + turned)


def _draw_line(simulation: MapSimulation, sizes: NDArray[np.int64], *, rng: np.random.Generator) -> NDArray[np.float64]:
    patterns, numbers = _members(sizes)
    steps_m = rng.uniform(*simulation.line_step_m, size=len(sizes))[patterns]
    along = (numbers - (sizes[patterns] - 1) / 2.0) * steps_m
    return np.column_stack([along, np.zeros_like(along)])


def _draw_circle(
    simulation: MapSimulation, sizes: NDArray[np.int64], *, rng: np.random.Generator
) -> NDArray[np.float64]:
    patterns, numbers = _members(sizes)
    radii_m = rng.uniform(*simulation.circle_radius_m, size=len(sizes))[patterns]
    angles = 2.0 * np.pi * numbers / sizes[patterns]
    return np.column_stack([radii_m * np.cos(angles), radii_m * np.sin(angles)])


def _draw_cluster(
    simulation: MapSimulation, sizes: NDArray[np.int64], *, rng: np.random.Generator
) -> NDArray[np.float64]:
    patterns, numbers = _members(sizes)
    sigmas_m = rng.uniform(*simulation.cluster_sigma_m, size=(len(sizes), 2))[patterns]
    return np.asarray(sigmas_m * rng.normal(size=(len(numbers), 2)))


def _draw_labels(simulation: MapSimulation, sizes: NDArray[np.int64], *, rng: np.random.Generator) -> NDArray[np.int64]:
    """Labels (N,) out of the classes of this map."""
    patterns, numbers = _members(sizes)
    classes = rng.permutation(simulation.vocabulary_size)[: _draw_count(simulation.classes, rng=rng)]
    labels = rng.choice(classes, size=len(numbers))
    shared = rng.choice(classes, size=len(sizes))[patterns]
    is_uniform = (rng.random(len(sizes)) < simulation.uniform_pattern_share)[patterns]
    return np.where(is_uniform, shared, labels).astype(np.int64)


def _members(sizes: NDArray[np.int64]) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Which pattern (N,) each object belongs to, and its number (N,) there from 0."""
    patterns = np.repeat(np.arange(len(sizes)), sizes)
    return patterns, np.arange(len(patterns)) - (np.cumsum(sizes) - sizes)[patterns]


def _draw_count(bounds: tuple[int, int], *, rng: np.random.Generator) -> int:
    return int(rng.integers(bounds[0], bounds[1], endpoint=True))


def _check_range(name: str, bounds: tuple[float, float], *, lowest: float) -> None:
    if not lowest <= bounds[0] <= bounds[1]:
        raise DescriptorError(f"{name} from {bounds[0]} to {bounds[1]}; give a range that starts at {lowest} or later")
