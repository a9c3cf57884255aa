"""Objects along the streets of a generated town: rows along the kerbs, scattered ones, corners, parks.

Classes are named, and about as frequent, as in cities mapped by hand: mostly trees, then signs, bollards and lamps.
"""

import numpy as np
import pandas as pd

from slam.common.arrays import FloatArray
from slam.simulation.world import World

CORNER_M = 10.0
"""Rows end that far before a crossing."""

SCATTERED_PER_100M = {
    "traffic_sign": 1.3,
    "bench": 0.5,
    "waste_basket": 0.35,
    "fire_hydrant": 0.4,
    "bicycle_parking": 0.35,
    "parking_meter": 0.25,
    "utility_pole": 0.2,
    "street_cabinet": 0.2,
    "post_box": 0.12,
    "bus_stop": 0.15,
    "advertising": 0.1,
}
"""Mean number on each side of 100 m of street."""

BEHIND_KERB_M = {"bench": 2.5, "street_cabinet": 2.5, "bus_stop": 1.5, "bicycle_parking": 1.5}
"""Where it is not right at the kerb."""


class Furniture:
    """Objects placed so far; one that would stand closer than 0.6 m to another is left out."""

    def __init__(self, rng: np.random.Generator) -> None:
        self._rng = rng
        self._labels: list[str] = []
        self._places: list[FloatArray] = []

    def place(self, label: str, xy: FloatArray) -> None:
        """Put an object of class ``label`` at ``xy`` (2,), metres, if there is room."""
        if self._places:
            apart = np.abs(self._places - xy).max(axis=1)
            if apart.min() < 0.6:
                return
        self._labels.append(label)
        self._places.append(xy)

    def world(self, tour: FloatArray) -> World:
        """The objects, named by class and number, at z = 0, with ``tour`` (M, 2), metres."""
        numbers = pd.Series(self._labels).groupby(self._labels).cumcount()
        ids = tuple(f"{label}-{number}" for label, number in zip(self._labels, numbers, strict=True))
        positions = np.column_stack([self._places, np.zeros(len(ids))])
        return World("street-grid", ids, positions, tuple(self._labels), tour)

    def furnish_street(self, start: FloatArray, end: FloatArray) -> None:
        """Both sides of the street between the crossings ``start`` and ``end`` (2,), metres."""
        rng, length_m = self._rng, float(np.linalg.norm(end - start))
        along = (end - start) / length_m
        left = np.array([-along[1], along[0]])
        kerb_m = rng.uniform(4.0, 8.0)
        tree_probability = rng.choice([0.15, 0.6, 0.95])  # bare street, mixed, avenue
        lamp_side = rng.choice([-1.0, 0.0, 1.0])  # 0: on both sides in turn
        for side in (-1.0, 1.0):

            def place(label: str, at_m: float, behind_m: float, outward: FloatArray = side * left) -> None:
                lateral = kerb_m + behind_m + rng.normal(0.0, 0.15)
                self.place(label, start + at_m * along + lateral * outward)

            if rng.random() < tree_probability:
                behind_m, gaps = rng.uniform(0.8, 1.6), rng.uniform(0.05, 0.35)
                for at_m in _row(length_m, rng.uniform(7.0, 15.0), 0.9, rng):
                    if rng.random() >= gaps:
                        place("tree", at_m, behind_m)
            if lamp_side in (side, 0.0):
                spacing_m = rng.uniform(24.0, 34.0) * (2.0 if lamp_side == 0.0 else 1.0)
                for at_m in _row(length_m, spacing_m, 0.7, rng):
                    place("street_lamp", at_m, 0.5)
            if rng.random() < 0.25:
                spacing_m, count = rng.uniform(1.4, 2.4), rng.integers(4, 11)
                first_m = rng.uniform(CORNER_M, max(CORNER_M, length_m - CORNER_M - count * spacing_m))
                for k in range(count):
                    place("bollard", first_m + k * spacing_m, 0.3)
            for label, density in SCATTERED_PER_100M.items():
                for at_m in rng.uniform(CORNER_M, length_m - CORNER_M, rng.poisson(0.01 * density * length_m)):
                    place(label, at_m, BEHIND_KERB_M.get(label, 0.5))

    def furnish_crossing(self, place: FloatArray, arms: list[FloatArray]) -> None:
        """The corners of the crossing at ``place`` (2,), metres, where streets leave along ``arms``, (2,) each."""
        rng, angles = self._rng, np.sort([np.arctan2(arm[1], arm[0]) for arm in arms])
        gaps = np.diff(np.append(angles, angles[0] + 2.0 * np.pi))
        signals = len(arms) >= 3 and rng.random() < 0.5
        for angle in angles + 0.5 * gaps:
            corner = place + rng.uniform(8.0, 11.0) * np.array([np.cos(angle), np.sin(angle)])
            if signals:
                self.place("traffic_signals", corner + rng.normal(0.0, 0.5, 2))
            if rng.random() < 0.5:
                self.place("traffic_sign", corner + rng.normal(0.0, 1.0, 2))

    def furnish_park(self, corners: FloatArray) -> None:
        """Scattered trees, benches and one fountain inside the block with the ``corners`` (4, 2), metres, in turn."""

        rng = self._rng

        def inside() -> FloatArray:
            u, v = rng.uniform(0.17, 0.83, 2)
            weights = np.array([(1.0 - u) * (1.0 - v), u * (1.0 - v), u * v, (1.0 - u) * v])
            return weights @ corners

        for label, count in (("tree", rng.integers(18, 36)), ("bench", rng.integers(3, 8)), ("fountain", 1)):
            for _ in range(count):
                self.place(label, inside())


def _row(length_m: float, spacing_m: float, jitter_m: float, rng: np.random.Generator) -> FloatArray:
    """Places along a street at about ``spacing_m``, clear of both crossings."""
    at_m = np.arange(CORNER_M + rng.uniform(0.0, spacing_m), length_m - CORNER_M, spacing_m)
    return at_m + rng.normal(0.0, jitter_m, len(at_m))
