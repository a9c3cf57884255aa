"""A generated town: irregular blocks, streets with furniture in rows, parks, and a tour with revisits."""

from itertools import pairwise

import numpy as np

from slam.common.arrays import FloatArray
from slam.common.errors import SimulationError
from slam.simulation.street_furniture import Furniture
from slam.simulation.world import World

COLUMNS, ROWS = 5, 4
"""Crossings east-west and north-south, before the town is turned."""

Crossing = tuple[int, int]
Places = dict[Crossing, FloatArray]
"""(2,) m, of all crossings."""
Neighbours = dict[Crossing, tuple[Crossing, ...]]
"""The crossings next to each, in a fixed order."""


def generate_street_grid(*, rng: np.random.Generator) -> World:
    """A generated town of 4 x 3 blocks and a tour of 1.5 to 2 km through it; world frame, metres, z = 0.

    Blocks are 65 to 130 m wide, crossings are shifted, two streets are closed, and the whole is turned by any angle.
    Trees and lamps stand in rows along the kerbs, with spacings of their own and gaps; the rest is scattered in
    frequencies as in mapped cities; traffic signals stand at the corners of crossings; one or two blocks are parks.
    The tour follows the centre lines in steps of about 1 m, never turns round on the spot, and drives at least two
    streets again in the same direction and two in the opposite one.

    Raises:
        SimulationError: no such tour was found; another seed gives another town.
    """
    places, neighbours = _lay_streets(rng)
    tour = _draw_tour(places, neighbours, rng)
    furniture = Furniture(rng)
    for a in places:
        for b in neighbours[a]:
            if a < b:
                furniture.furnish_street(places[a], places[b])
    for crossing, place in places.items():
        furniture.furnish_crossing(place, [places[other] - place for other in neighbours[crossing]])
    parks = {(int(rng.integers(COLUMNS - 1)), int(rng.integers(ROWS - 1))) for _ in range(2)}
    for column, row in sorted(parks):
        corners = [(column, row), (column + 1, row), (column + 1, row + 1), (column, row + 1)]
        furniture.furnish_park(np.stack([places[corner] for corner in corners]))
    return furniture.world(_points_along([places[crossing] for crossing in tour]))


def _lay_streets(rng: np.random.Generator) -> tuple[Places, Neighbours]:
    x, y = (np.append(0.0, np.cumsum(rng.uniform(65.0, 130.0, count - 1))) for count in (COLUMNS, ROWS))
    angle = rng.uniform(-np.pi, np.pi)
    R = np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
    crossings = [(column, row) for column in range(COLUMNS) for row in range(ROWS)]
    places = {
        (column, row): R @ (np.array([x[column], y[row]]) + rng.normal(0.0, 5.0, 2).clip(-10.0, 10.0))
        for column, row in crossings
    }
    # Only streets between two inner crossings are closed, so that every crossing keeps two arms or more.
    inner = [(c, r) for c, r in crossings if 0 < c < COLUMNS - 1 and 0 < r < ROWS - 1]
    closable = [((c, r), (c + 1, r)) for c, r in inner if (c + 1, r) in inner]
    closed = [set(closable[i]) for i in rng.choice(len(closable), 2, replace=False)]
    neighbours = {
        (c, r): tuple(
            other
            for other in ((c - 1, r), (c, r - 1), (c, r + 1), (c + 1, r))
            if other in places and {(c, r), other} not in closed
        )
        for c, r in crossings
    }
    return places, neighbours


def _draw_tour(places: Places, neighbours: Neighbours, rng: np.random.Generator) -> list[Crossing]:
    """Walk at random, never straight back, until a walk revisits as many streets as it should."""
    crossings = list(places)
    for _ in range(20_000):
        tour = [crossings[rng.integers(len(crossings))]]
        min_m, driven_m = 1500.0, 0.0
        target_m = rng.uniform(min_m, 2000.0)
        while True:
            onward = [other for other in neighbours[tour[-1]] if len(tour) < 2 or other != tour[-2]]
            following = onward[rng.integers(len(onward))]
            street_m = float(np.linalg.norm(places[following] - places[tour[-1]]))
            if driven_m + street_m > target_m:
                break
            driven_m += street_m
            tour.append(following)
        same, opposite = _revisits(tour)
        if driven_m >= min_m and 2 <= same <= 5 and 2 <= opposite <= 5:
            return tour
    raise SimulationError("no tour with enough revisits; take another seed")


def _revisits(tour: list[Crossing]) -> tuple[int, int]:
    """How many streets of the tour had been driven before in the same direction, and how many in the opposite one."""
    same = opposite = 0
    driven = set()
    for a, b in pairwise(tour):
        same += (a, b) in driven
        opposite += (b, a) in driven
        driven.add((a, b))
    return same, opposite


def _points_along(corners: list[FloatArray]) -> FloatArray:
    pieces = []
    for start, end in pairwise(corners):
        count = max(1, round(np.linalg.norm(end - start)))
        pieces.append(start + (end - start) * (np.arange(count) / count)[:, None])
    return np.concatenate([*pieces, corners[-1][None]])
