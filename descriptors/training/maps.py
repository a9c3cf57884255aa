"""Maps to train on: simulated streets, forests and patterns, and pieces of real maps that are given."""

from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike
from scipy.spatial import cKDTree

from descriptors.arrays import ComplexArray, FloatArray, IntArray, frozen


@frozen
class TrainingMap:
    """Objects at ``positions`` (N, 3) m, gravity along z, with ``labels`` (N,) below ``classes``."""

    positions: FloatArray
    labels: IntArray
    classes: int

    def __len__(self) -> int:
        return len(self.labels)

    @staticmethod
    def of(positions: FloatArray, labels: ArrayLike) -> "TrainingMap":
        """Objects with labels (N,) of any kind, whose classes are numbered in ascending order."""
        found, numbers = np.unique(labels, return_inverse=True)
        return TrainingMap(positions, numbers, len(found))


PATTERNS = ("line", "circle", "cluster")
PIECE_OBJECTS = 1000
"""Most objects of a piece of a given map, and about those of a simulated one: a step takes them in within a second."""


def draw_map(given: Sequence[TrainingMap], own_share: float, *, rng: np.random.Generator) -> TrainingMap:
    """A street, a forest, superimposed patterns, or, with the probability ``own_share``, a piece of a given map."""
    if given and rng.random() < own_share:
        return piece_of(given[int(rng.integers(len(given)))], rng=rng)
    draw = (draw_street, draw_forest, draw_patterns)[rng.integers(3)]
    return draw(rng=rng)


def with_classes_of(drawn: TrainingMap, vocabulary_size: int, *, rng: np.random.Generator) -> TrainingMap:
    """The map with its classes dealt out among the rows of an embedding; those that exceed it share rows."""
    rows = rng.permutation(vocabulary_size)
    return TrainingMap(drawn.positions, rows[drawn.labels % vocabulary_size], vocabulary_size)


def piece_of(given: TrainingMap, *, rng: np.random.Generator) -> TrainingMap:
    """The objects around one that is drawn, sometimes drawn together: parks are denser than streets.

    A class may be merged with all others, as by a detector that does not tell them apart.
    """
    offsets = given.positions[:, :2] - given.positions[rng.integers(len(given)), :2]
    near = np.argsort(np.einsum("ij,ij->i", offsets, offsets), kind="stable")[:PIECE_OBJECTS]
    factor = np.exp(rng.uniform(np.log(0.3), 0.0)) if rng.random() < 0.5 else 1.0
    positions = given.positions[near] * (factor, factor, 1.0)
    labels = given.labels[near]
    if rng.random() < 0.3:
        labels = labels % rng.integers(1, 4)
    return TrainingMap.of(positions, labels)


def draw_patterns(*, rng: np.random.Generator) -> TrainingMap:
    """Superimposed patterns of objects: lines, circles and clusters anywhere, of which some repeat one label.

    Xing et al., Descriptellation: Deep Learned Constellation Descriptors, Section III-E. The paper names the patterns
    and the kinds of distributions but none of the ranges, and no pattern of one label, as the lamps of a row have.
    """
    count = rng.integers(2, 30, endpoint=True)
    classes = rng.permutation(64)[:count]
    plans, labels = [], []
    for _ in range(rng.integers(40, 80, endpoint=True)):
        size = int(rng.integers(3, 9, endpoint=True))
        heading = np.exp(1j * rng.uniform(-np.pi, np.pi))
        middle = complex(*rng.uniform(0.0, 300.0, 2))
        plans.append(middle + heading * draw_pattern(PATTERNS[rng.integers(len(PATTERNS))], size, rng=rng))
        labels.append(np.full(size, rng.choice(classes)) if rng.random() < 0.4 else rng.choice(classes, size=size))
    plan = np.concatenate(plans)
    heights = rng.normal(scale=1.5, size=len(plan))
    return TrainingMap.of(np.column_stack([plan.real, plan.imag, heights]), np.concatenate(labels))


def draw_pattern(kind: str, size: int, *, rng: np.random.Generator) -> ComplexArray:
    """Horizontal places (size,), x + iy in metres about the middle, of one pattern."""
    numbers = np.arange(size)
    match kind:
        case "line":
            return np.asarray((numbers - (size - 1) / 2.0) * (1.0 + 0.0j) * rng.uniform(4.0, 12.0))
        case "circle":
            return rng.uniform(4.0, 20.0) * np.exp(2j * np.pi * numbers / size)
        case _:
            x, y = rng.uniform(3.0, 15.0, (2, 1)) * rng.normal(size=(2, size))
            return x + 1j * y


def draw_forest(*, rng: np.random.Generator) -> TrainingMap:
    """Stems anywhere, no two of them too near each other, of one class or a few; 3 to 30 a thousand square metres."""
    density = np.exp(rng.uniform(np.log(0.003), np.log(0.03)))
    side_m = np.sqrt(PIECE_OBJECTS / density)
    places = rng.uniform(0.0, side_m, (2 * PIECE_OBJECTS, 2))
    crowded_pairs = cKDTree(places).query_pairs(rng.uniform(0.2, 0.5) / np.sqrt(density), output_type="ndarray")
    places = np.delete(places, np.unique(crowded_pairs.max(axis=1)), axis=0)
    waves = np.sin(places * (2.0 * np.pi / side_m * rng.uniform(0.5, 3.0, 2)) + rng.uniform(-np.pi, np.pi, 2))
    crowded = rng.uniform(0.0, 0.8) * (0.5 + 0.25 * waves.sum(axis=1))  # glades between thickets
    places = places[rng.random(len(places)) >= crowded][:PIECE_OBJECTS]
    classes = int(rng.choice([1, 1, 2, 3]))
    heights = rng.normal(0.0, 0.5, len(places))
    return TrainingMap(np.column_stack([places, heights]), rng.integers(classes, size=len(places)), classes)


def draw_street(*, rng: np.random.Generator) -> TrainingMap:
    """Winding streets with rows of equal things on both sides, and others between them, a few classes of them often."""
    streets, length_m = rng.integers(2, 5), 300.0
    classes = rng.integers(3, 31)
    shares = 1.0 / np.arange(1, classes + 1) ** rng.uniform(0.3, 1.5)
    gathered, labels = [], []
    for street in range(streets):
        pieces = list[tuple[FloatArray, FloatArray, IntArray]]()
        while sum(len(kinds) for *_, kinds in pieces) < PIECE_OBJECTS * rng.uniform(0.3, 0.6) / streets:
            step_m = rng.uniform(3.0, 30.0)
            start_m = rng.uniform(0.0, length_m)
            row = np.arange(start_m, min(start_m + rng.uniform(30.0, 150.0), length_m), step_m)
            along_m = row + rng.normal(0.0, 0.05 * step_m, len(row))
            aside_m = rng.choice([-1.0, 1.0]) * rng.uniform(4.0, 9.0) + rng.normal(0.0, 0.3, len(row))
            pieces.append((along_m, aside_m, np.full(len(row), rng.integers(classes))))
        scattered = int(rng.uniform(0.1, 0.5) * PIECE_OBJECTS / streets)
        along_m = rng.uniform(0.0, length_m, scattered)
        aside_m = rng.choice([-1.0, 1.0], scattered) * rng.uniform(4.0, 14.0, scattered)
        pieces.append((along_m, aside_m, rng.choice(classes, scattered, p=shares / shares.sum())))
        along_m, aside_m, kinds = (np.concatenate(each) for each in zip(*pieces, strict=True))
        gathered.append(_bent(along_m, aside_m, street, rng=rng))
        labels.append(kinds)
    positions = np.concatenate(gathered)
    found, numbers = np.unique(np.concatenate(labels), return_inverse=True)
    heights = rng.uniform(0.3, 4.0, len(found))[numbers] + rng.normal(0.0, 0.2, len(positions))
    return TrainingMap(np.column_stack([positions, heights]), numbers, len(found))


def _bent(along_m: FloatArray, aside_m: FloatArray, street: int, *, rng: np.random.Generator) -> FloatArray:
    """Places (N, 2) beside a street that begins at an offset of its own and bends now and then."""
    steps = np.arange(0.0, 310.0)
    headings = np.interp(steps / 60.0, np.arange(7), np.cumsum(rng.normal(0.0, 0.3, 7)) + rng.uniform(-np.pi, np.pi))
    line = np.cumsum(np.column_stack([np.cos(headings), np.sin(headings)]), axis=0) + 120.0 * street
    at = np.clip(along_m, 0.0, 309.0)
    heading = np.interp(at, steps, headings)
    on_line = np.column_stack([np.interp(at, steps, line[:, axis]) for axis in (0, 1)])
    return on_line + aside_m[:, None] * np.column_stack([-np.sin(heading), np.cos(heading)])
