"""One long street with much on it, in the manner of Paris-Rue-Lille's Lille1."""

from __future__ import annotations

import numpy as np

from slam.common.arrays import FloatArray
from slam.simulation.world import World
from tools.lab.retrieval.labelled_map import LabelledMap, labelled_map

LENGTH_M = 1150.0
OBJECTS = 795
CLASSES = 25
"""As many as are left of Lille1 without what moves and without bollards (Descriptellation, Table I)."""
ROWS = {"lamp": 27.0, "tree": 9.0, "post": 4.0}
"""Classes that stand in rows, and their spacing in metres; a row is a stretch of one side."""
ROW_SHARE = 0.35
"""Of the objects."""
ROW_M = (40.0, 150.0)
KERB_M, FACADE_M = 4.5, 11.0
BEND_EVERY_M = 90.0
BEND_SIGMA_RAD = 0.25


def generate_street(*, rng: np.random.Generator, name: str = "street") -> World:
    """A winding street of 1150 m with 795 objects of 25 classes, driven from end to end; world frame, metres.

    A third of the objects stand in rows; the rest, of classes from frequent to rare (the k-th in proportion to 1 / k),
    stand anywhere between kerb and facade, at a height of their class.
    """
    tour = _centre_line(rng)
    labels, along_m, aside_m = _rows(rng)
    scattered = OBJECTS - len(labels)
    names = [f"class_{number:02d}" for number in range(CLASSES - len(ROWS))]
    shares = 1.0 / np.arange(1, len(names) + 1)
    drawn = np.concatenate(
        [np.arange(len(names)), rng.choice(len(names), scattered - len(names), p=shares / shares.sum())]
    )
    labels += [names[k] for k in drawn]
    along_m = np.concatenate([along_m, rng.uniform(0.0, LENGTH_M, scattered)])
    aside_m = np.concatenate([aside_m, rng.choice([-1.0, 1.0], scattered) * rng.uniform(KERB_M, FACADE_M, scattered)])
    heights = dict(zip(sorted(set(labels)), rng.uniform(0.3, 4.0, CLASSES), strict=True))
    positions = _beside(tour, along_m, aside_m)
    z = np.array([heights[label] for label in labels]) + rng.normal(0.0, 0.1, OBJECTS)
    ids = tuple(f"object-{number}" for number in range(OBJECTS))
    return World(name, ids, np.column_stack([positions, z]), tuple(labels), tour)


def start_of_street(length_m: int) -> tuple[LabelledMap, FloatArray]:
    """The objects within 30 m of the first part of the street, and its tour."""
    world = generate_street(rng=np.random.default_rng(0))
    objects, tour = labelled_map(world), world.tour[:length_m]
    near = np.flatnonzero(np.min([np.hypot(*(objects.positions[:, :2] - p).T) for p in tour], axis=0) < 30.0)
    return LabelledMap(objects.positions[near], objects.labels[near], objects.vocabulary), tour


def _centre_line(rng: np.random.Generator) -> FloatArray:
    """Points (M, 2), one a metre; the heading changes evenly between one bend and the next."""
    bends = np.cumsum(rng.normal(0.0, BEND_SIGMA_RAD, int(np.ceil(LENGTH_M / BEND_EVERY_M)) + 1))
    steps = np.arange(LENGTH_M)
    headings = np.interp(steps / BEND_EVERY_M, np.arange(len(bends)), bends)
    points = np.cumsum(np.column_stack([np.cos(headings), np.sin(headings)]), axis=0)
    return np.asarray(np.vstack([np.zeros(2), points]))


def _rows(rng: np.random.Generator) -> tuple[list[str], FloatArray, FloatArray]:
    """Labels, and places along and beside the street (N,), m, of what stands in rows."""
    labels: list[str] = []
    along: list[float] = []
    aside: list[float] = []
    classes = list(ROWS)  # each has a row at least
    while len(labels) < ROW_SHARE * OBJECTS:
        label = classes.pop() if classes else str(rng.choice(list(ROWS)))
        start, lateral = rng.uniform(0.0, LENGTH_M), rng.choice([-1.0, 1.0]) * rng.uniform(KERB_M, KERB_M + 2.0)
        places = np.arange(start, min(start + rng.uniform(*ROW_M), LENGTH_M), ROWS[label])
        labels += [label] * len(places)
        along += list(places + rng.normal(0.0, 0.4, len(places)))
        aside += list(lateral + rng.normal(0.0, 0.15, len(places)))
    return labels, np.clip(along, 0.0, LENGTH_M), np.asarray(aside)


def _beside(tour: FloatArray, along_m: FloatArray, aside_m: FloatArray) -> FloatArray:
    """Points (N, 2) at places along the ``tour``, so far to its left."""
    travelled = np.append(0.0, np.cumsum(np.linalg.norm(np.diff(tour, axis=0), axis=1)))
    on_line = np.column_stack([np.interp(along_m, travelled, tour[:, axis]) for axis in (0, 1)])
    segment = np.clip(np.searchsorted(travelled, along_m, side="right") - 1, 0, len(tour) - 2)
    forward = tour[segment + 1] - tour[segment]
    left = np.column_stack([-forward[:, 1], forward[:, 0]]) / np.linalg.norm(forward, axis=1, keepdims=True)
    return np.asarray(on_line + aside_m[:, None] * left)
