"""Prediction of the detections of a scan, by a trajectory, from those made on other visits to the same place.

A trajectory that drifts places what was seen on two visits apart. No association and no landmark takes part: each
trajectory makes its own map of the detections, and all predict the same scans.
"""

import numpy as np
from scipy.spatial import KDTree

from logs.records import frozen
from slam.common.arrays import FloatArray, IntArray
from slam.common.geometry import apply_each, polar_cells

CLUTTER = 0.1
"""Share of the detections that the map need not explain. It bounds what one of them can say against a trajectory."""
RINGS, SECTORS = 8, 24
"""Cells of the field of view: rings of equal width, by sectors."""


@frozen
class SampledScan:
    """Detections (D, 3) m in the body frame with their classes (D,), and where the body was.

    ``travel_m``: path length up to the scan; ``T_odom_body`` (4, 4): by the odometry, as it reported; ``T_online_body``
    (4, 4): in the map, as published at the time of the scan.
    """

    stamp_ns: int
    positions: FloatArray
    labels: IntArray
    travel_m: float
    T_odom_body: FloatArray
    T_online_body: FloatArray


class VisitPredictor:
    """Predicts scans, one at least, by trajectories; ``sigma_m``: deviation of an object's position between visits."""

    def __init__(self, scans: tuple[SampledScan, ...], *, sensor_range_m: float, sigma_m: float) -> None:
        self._range_m = sensor_range_m
        self._sigma_m = sigma_m
        self._travel_m = np.array([scan.travel_m for scan in scans])
        positions = np.concatenate([scan.positions for scan in scans])
        in_range = np.linalg.norm(positions, axis=1) < sensor_range_m
        self._positions = positions[in_range]
        self._labels = np.concatenate([scan.labels for scan in scans])[in_range]
        self._scan_of = np.repeat(np.arange(len(scans)), [len(scan.positions) for scan in scans])[in_range]
        self._starts = np.searchsorted(self._scan_of, np.arange(len(scans) + 1))
        self._shares = np.bincount(self._labels) / len(self._labels)
        # The density of the detections around the body, in the plane in which they are spread most.
        count = max(len(self._positions), 1)
        offsets = self._positions - self._positions.sum(axis=0) / count
        self._axes = np.linalg.eigh(offsets.T @ offsets)[1][:, 1:]
        counts = np.zeros((RINGS, SECTORS))
        np.add.at(counts, self._cells(self._positions), 1.0)
        widths = np.diff(np.linspace(0.0, sensor_range_m, RINGS + 1) ** 2)
        self._densities = counts / (np.pi / SECTORS * widths[:, None] * count)

    def predict(self, T_world_body: FloatArray, queries: IntArray) -> tuple[FloatArray, IntArray]:
        """Predict the scans ``queries`` (Q,) by the trajectory ``T_world_body`` (N, 4, 4) of all N scans.

        Returns:
            Gains (Q,): logarithm of the density of their detections beside that in the field of view of any scan,
            summed; and how many (Q,) are predicted, 0 where the trajectory places no detection of another visit there.
        """
        R, t = T_world_body[:, :3, :3], T_world_body[:, :3, 3]
        points = apply_each(T_world_body[self._scan_of], self._positions)
        tree = KDTree(points)
        gains, counts = np.zeros(len(queries)), np.zeros(len(queries), dtype=np.int64)
        for place, query in enumerate(queries.tolist()):
            near = np.array(tree.query_ball_point(t[query], self._range_m, return_sorted=True), dtype=np.int64)
            visit_m = np.abs(self._travel_m[self._scan_of[near]] - self._travel_m[query])
            # After two sensor ranges of travel nothing that was in view before need still be; a thousand tell enough.
            sources = _thinned(near[visit_m > 2.0 * self._range_m], 1000)
            seen = (points[sources] - t[query]) @ R[query]
            gains[place], counts[place] = self._gain(query, seen, self._labels[sources])
        return gains, counts

    def _gain(self, query: int, seen: FloatArray, labels: IntArray) -> tuple[float, int]:
        """Gain, and number of detections that are predicted.

        The sources ``seen`` (M, 3) m are in the frame of the body, of the classes ``labels`` (M,).
        Each source is expected in view as often as detections are there. The kernel has the same weight for all orders
        of magnitude between the noise and the sensor range, so that a smaller error always predicts better.
        """
        expected = self._density(seen)
        if not expected.sum() > 0.0:
            return 0.0, 0
        chosen = _thinned(np.arange(self._starts[query], self._starts[query + 1]), 64)  # more would be redundant
        positions = self._positions[chosen]
        offsets = (positions @ self._axes)[:, None] - seen @ self._axes
        squares = np.einsum("dmi,dmi->dm", offsets, offsets)
        span = np.pi * np.log1p((self._range_m / self._sigma_m) ** 2)
        own_labels = self._labels[chosen]
        may_match = (squares < self._range_m**2) & (own_labels[:, None] == labels)
        kernels = np.where(may_match, 1.0 / (span * (squares + self._sigma_m**2)), 0.0)
        chance = self._density(positions) * self._shares[own_labels]
        ratios = kernels @ expected / (expected.sum() * np.maximum(chance, np.finfo(np.float64).tiny))
        return np.log(CLUTTER + (1.0 - CLUTTER) * ratios).sum(), len(chosen)

    def _density(self, positions: FloatArray) -> FloatArray:
        """Share of the detections per area [1/m^2] at positions (N, 3) m, body frame, within the range."""
        return self._densities[self._cells(positions)]

    def _cells(self, positions: FloatArray) -> tuple[IntArray, IntArray]:
        """Cells of the field of view at positions (N, 3) m."""
        rings, sectors = polar_cells(positions @ self._axes, self._range_m, RINGS, SECTORS)
        return np.minimum(rings, RINGS - 1), sectors


def _thinned(indices: IntArray, most: int) -> IntArray:
    """At most so many of some indices, evenly spread."""
    return indices[:: max(-(-len(indices) // most), 1)]
