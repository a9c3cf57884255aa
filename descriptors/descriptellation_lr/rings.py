"""What query and map have in common: rings of distance, and the features of neighbours and rings."""

from __future__ import annotations

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view
from numpy.typing import NDArray
from pydantic import ConfigDict
from pydantic.dataclasses import dataclass

from descriptors.constellation import Constellations

FEATURES = 6
"""Numbers that :func:`neighbour_features` gives for each neighbour."""
FINE = 1024
"""Steps into which the distance of a neighbour of the map is rounded before kernels are laid over it: 6 cm, half of the
narrowest kernel."""
SMOOTHED_RINGS = 4
"""Rings to either side over which the background is averaged: few counts of a small map are spread over 2 m."""
PRIOR_OBJECTS = 2.0
"""Constellations that the prior background stands for: a few of the map outweigh it."""
PRIOR_PER_KM2 = 500.0
"""Objects of one class on a square kilometre of a city."""
SHARED = 0.5
"""Share of the background that all classes have in common: half, as nothing is known of how much they differ."""


@dataclass(frozen=True, slots=True, config=ConfigDict(extra="forbid"))
class DescriptellationLRArchitecture:
    """Sizes of the likelihood. ``widths_m`` and ``widths_per_m``: of the kernels before training, at distance 0 and how
    they grow with it; ``level_width_m``, ``level_width_per_m``: of the kernel that measures how crowded an object is;
    ``odds``: of a gate before training, P_D / (1 - P_D) with P_D 0.75.
    """

    name: str = "descriptellation_lr"
    radius_m: float = 60.0
    least_ring_m: float = 0.25
    ring_growth: float = 0.02
    hidden: int = 24
    ring_hidden: int = 8
    widths_m: tuple[float, ...] = (0.12, 0.3, 0.7, 1.0)
    widths_per_m: tuple[float, ...] = (0.002, 0.01, 0.03, 0.08)
    level_width_m: float = 3.0
    level_width_per_m: float = 0.05
    odds: float = 3.0

    @property
    def rings(self) -> Rings:
        """The rings."""
        return Rings(self.radius_m, self.least_ring_m, self.ring_growth)


class Rings:
    """R rings out to ``radius_m``, at least ``least_width_m`` wide and ``growth`` of their distance: errors grow, too.

    ``edges_m`` (R + 1,) from 0 to ``radius_m``; ``middles_m`` and ``widths_m`` (R,); ``fine_m`` (FINE,): the distances
    that neighbours of the map are rounded to.
    """

    def __init__(self, radius_m: float, least_width_m: float, growth: float) -> None:
        edges = [0.0]
        while edges[-1] < radius_m:
            edges.append(edges[-1] + max(least_width_m, growth * edges[-1]))
        self.radius_m = radius_m
        self.edges_m = np.asarray(edges) * (radius_m / edges[-1])
        self.middles_m = 0.5 * (self.edges_m[1:] + self.edges_m[:-1])
        self.widths_m = np.diff(self.edges_m)
        self.fine_m = (np.arange(FINE) + 0.5) * (radius_m / FINE)

    def __len__(self) -> int:
        return len(self.widths_m)

    def of(self, distances_m: NDArray[np.float64]) -> NDArray[np.int64]:
        """The ring (P,) of each distance; what is farther than all is in the last."""
        return np.clip(np.searchsorted(self.edges_m, distances_m, side="right") - 1, 0, len(self) - 1)

    def fine(self, distances_m: NDArray[np.float64]) -> NDArray[np.int64]:
        """The step (P,) of each distance, of ``FINE``."""
        return np.clip((distances_m * (FINE / self.radius_m)).astype(np.int64), 0, FINE - 1)


def horizontal_m(positions: NDArray[np.float64]) -> NDArray[np.float64]:
    """Lengths (P,) of positions (P, 3) in the plane."""
    return np.hypot(positions[:, 0], positions[:, 1])


def neighbour_features(constellations: Constellations) -> NDArray[np.float32]:
    """Features (P, FEATURES) of each neighbour for the gates; none of them changes when the sensor turns.

    Its distance; how many neighbours the centre has; the share of its class among them; whether that is the class of
    the centre; how many of its class stand equally far from the centre; its height above the centre.
    """
    distances_m = horizontal_m(constellations.positions)
    owners = constellations.owners
    counts = np.diff(constellations.offsets)[owners]
    size = max(len(constellations.vocabulary), 1)
    keys = owners * size + constellations.labels
    of_class = np.bincount(keys, minlength=len(constellations) * size)[keys]
    beside = np.bincount(keys * 64 + np.minimum(distances_m, 63.0).astype(np.int64))
    level = beside[keys * 64 + np.minimum(distances_m, 63.0).astype(np.int64)]
    same = constellations.labels == constellations.centre_labels[owners]
    return np.column_stack(
        [
            np.log(np.maximum(distances_m, 0.3) / 10.0),
            np.log1p(counts) / 3.0 - 1.0,
            np.log(of_class / np.maximum(counts, 1)),
            same,
            np.log(level),
            np.minimum(np.abs(constellations.positions[:, 2]), 5.0) / 2.0,
        ]
    ).astype(np.float32)


def ring_features(background: NDArray[np.float64], rings: Rings) -> NDArray[np.float64]:
    """Features (C, R, 2) of each ring: its distance, and how much is there in an average place."""
    middles = np.broadcast_to(np.log(rings.middles_m / 10.0), background.shape)
    return np.stack([middles, np.log(background)], axis=2)


class Background:
    """Density (C, R) of neighbours around an average object of the map, per metre of distance."""

    def __init__(self, rings: Rings) -> None:
        self._rings = rings
        self._prior = 2.0 * np.pi * rings.middles_m * PRIOR_PER_KM2 * 1e-6
        self._spans_m = _summed(rings.widths_m[None])
        self._counts = np.zeros((0, len(rings)))
        self._objects = 0

    def add(self, constellations: Constellations) -> None:
        """Take in more objects of the map; the vocabulary may have grown at its end."""
        size = len(constellations.vocabulary)
        if size > len(self._counts):
            self._counts = np.vstack([self._counts, np.zeros((size - len(self._counts), len(self._rings)))])
        cells = constellations.labels * len(self._rings) + self._rings.of(horizontal_m(constellations.positions))
        self._counts += np.bincount(cells, minlength=self._counts.size).reshape(self._counts.shape)
        self._objects += len(constellations)

    def density(self, classes: int) -> NDArray[np.float64]:
        """(C, R) for a vocabulary of so many classes, above 0 everywhere."""
        counts = np.vstack([self._counts, np.zeros((max(classes - len(self._counts), 0), len(self._rings)))])
        smooth = _summed(counts) / self._spans_m
        own = (smooth + PRIOR_OBJECTS * self._prior) / (self._objects + PRIOR_OBJECTS)
        return np.asarray((1.0 - SHARED) * own + SHARED * own.mean(axis=0, keepdims=True))


def _summed(rows: NDArray[np.float64]) -> NDArray[np.float64]:
    """Rows (C, R), each ring with those to either side of it."""
    padded = np.pad(rows, ((0, 0), (SMOOTHED_RINGS, SMOOTHED_RINGS)))
    return np.asarray(sliding_window_view(padded, 2 * SMOOTHED_RINGS + 1, axis=1).sum(axis=-1))
