"""The object map: every landmark with its place, its class and its life, as arrays with one row a landmark.

A landmark's row is its id for good. Its life: ``TENTATIVE`` from its first sighting; ``CONFIRMED`` once it was seen
often enough; ``RETIRED`` with a reason when it turns out to be no landmark, or to be another one.
"""

from __future__ import annotations

from enum import IntEnum, StrEnum

import numpy as np
from numpy.typing import NDArray

from logs.messages import ObjectMapRecord
from slam.config import AssociationConfig
from slam.geometry import FloatArray, IntArray


class LandmarkState(IntEnum):
    """Where a landmark stands in its life."""

    TENTATIVE = 0
    CONFIRMED = 1
    RETIRED = 2


class RetirementReason(StrEnum):
    """Why a landmark is one no longer."""

    NOT_CONFIRMED = "not_confirmed"
    MOVING = "moving"
    MERGED = "merged"


LANDMARK = np.dtype(
    [
        ("state", np.int8),
        ("observations", np.int64),  # detections assigned to it
        ("first_scan", np.int64),  # numbers of the first and the last scan that saw it
        ("last_scan", np.int64),
        ("first_seen_ns", np.int64),
        ("last_seen_ns", np.int64),
        ("last_seen_travel_m", np.float64),
        # Where it is relative to the robot: a filter in the odometry frame, which is smooth around the robot.
        ("position_odom", np.float64, 3),
        ("covariance_odom", np.float64, (3, 3)),
        ("velocity_odom", np.float64, 3),  # zero unless it seems to move
        # Where it is in the optimised map.
        ("position_map", np.float64, 3),
        ("covariance_map", np.float64, (3, 3)),
        # Sums over its sightings, of time since the first [s] and of position relative to the first [m].
        ("sum_t", np.float64),
        ("sum_tt", np.float64),
        ("sum_p", np.float64, 3),
        ("sum_tp", np.float64, 3),
        ("first_position_odom", np.float64, 3),
    ]
)


class ObjectMap:
    """Landmarks and the vocabulary of their classes."""

    def __init__(self, config: AssociationConfig) -> None:
        self._config = config
        self._rows = np.zeros(64, dtype=LANDMARK)
        self._label_counts = np.zeros((64, 8))
        self._size = 0
        self._reasons: dict[int, str] = {}
        self._merged_into: dict[int, int] = {}
        self._label_index: dict[str, int] = {}

    def __len__(self) -> int:
        return self._size

    @property
    def rows(self) -> NDArray[np.void]:
        """(L,) structured array of ``LANDMARK``: a view, so that assigning to a field of it changes the map."""
        return self._rows[: self._size]

    @property
    def vocabulary(self) -> tuple[str, ...]:
        """Class names in the order in which they were first seen; the index of a label is its place here."""
        return tuple(self._label_index)

    def label_indices(self, labels: tuple[str, ...]) -> IntArray:
        """Index (N,) of each label; a new one is added to the vocabulary."""
        for label in labels:
            self._label_index.setdefault(label, len(self._label_index))
        if len(self._label_index) > self._label_counts.shape[1]:
            wider = np.zeros((len(self._label_counts), 2 * len(self._label_index)))
            wider[:, : self._label_counts.shape[1]] = self._label_counts
            self._label_counts = wider
        return np.array([self._label_index[label] for label in labels], dtype=np.int64)

    def in_state(self, state: LandmarkState) -> IntArray:
        """Rows in that state, ascending."""
        return np.flatnonzero(self.rows["state"] == state)

    def beliefs(self, rows: IntArray) -> FloatArray:
        """Class probabilities (N, C): the posterior of even priors and independent labels of the configured accuracy.

        With accuracy p and C classes a label multiplies the odds of its class by p (C - 1) / (1 - p).
        """
        classes = len(self._label_index)
        if classes < 2:
            return np.ones((len(rows), classes))
        accuracy = self._config.label_accuracy
        odds = np.log(accuracy * (classes - 1) / (1.0 - accuracy))
        logits = self._label_counts[rows, :classes] * odds
        weights = np.exp(logits - logits.max(axis=1, keepdims=True))
        return np.asarray(weights / weights.sum(axis=1, keepdims=True))

    def add(
        self,
        positions_odom: FloatArray,
        covariances_odom: FloatArray,
        labels: IntArray,
        *,
        stamp_ns: int,
        scan: int,
        travel_m: float,
    ) -> IntArray:
        """Make tentative landmarks of detections (N, 3) m with (N, 3, 3) m^2; returns their rows (N,)."""
        new = np.arange(self._size, self._size + len(positions_odom))
        self._reserve(self._size + len(positions_odom))
        self._size += len(positions_odom)
        landmarks = self.rows
        landmarks["state"][new] = LandmarkState.TENTATIVE
        landmarks["observations"][new] = 1
        landmarks["first_scan"][new] = scan
        landmarks["last_scan"][new] = scan
        landmarks["first_seen_ns"][new] = stamp_ns
        landmarks["last_seen_ns"][new] = stamp_ns
        landmarks["last_seen_travel_m"][new] = travel_m
        landmarks["position_odom"][new] = positions_odom
        landmarks["first_position_odom"][new] = positions_odom
        landmarks["covariance_odom"][new] = covariances_odom
        self._label_counts[new, labels] = 1.0
        return new

    def record_sightings(
        self, rows: IntArray, measured_odom: FloatArray, labels: IntArray, *, stamp_ns: int, scan: int, travel_m: float
    ) -> None:
        """Count one more sighting of each of ``rows`` (N,), at ``measured_odom`` (N, 3) m, with its label (N,)."""
        landmarks = self.rows
        seconds = (stamp_ns - landmarks["first_seen_ns"][rows]) * 1e-9
        offset = measured_odom - landmarks["first_position_odom"][rows]
        landmarks["observations"][rows] += 1
        landmarks["last_scan"][rows] = scan
        landmarks["last_seen_ns"][rows] = stamp_ns
        landmarks["last_seen_travel_m"][rows] = travel_m
        landmarks["sum_t"][rows] += seconds
        landmarks["sum_tt"][rows] += seconds**2
        landmarks["sum_p"][rows] += offset
        landmarks["sum_tp"][rows] += seconds[:, None] * offset
        self._label_counts[rows, labels] += 1.0

    def velocities(self, rows: IntArray) -> FloatArray:
        """Velocity (N, 3) m/s in the odometry frame: the least-squares line through all sightings."""
        landmarks = self.rows[rows]
        slope = (
            landmarks["sum_tp"] - landmarks["sum_t"][:, None] * landmarks["sum_p"] / landmarks["observations"][:, None]
        )
        return np.asarray(slope / self._time_spreads(rows)[:, None])

    def speed_sigmas(self, rows: IntArray, position_sigmas_m: FloatArray) -> FloatArray:
        """Standard deviation (N,) m/s of each coordinate of the velocity, for that noise (N,) m of a sighting."""
        return np.asarray(position_sigmas_m / np.sqrt(self._time_spreads(rows)))

    def _time_spreads(self, rows: IntArray) -> FloatArray:
        """Sum of squared deviations (N,) s^2 of the times of the sightings from their mean, at least (1 ms)^2."""
        landmarks = self.rows[rows]
        return np.asarray(np.maximum(landmarks["sum_tt"] - landmarks["sum_t"] ** 2 / landmarks["observations"], 1e-6))

    def confirm(self, rows: IntArray) -> None:
        """Make tentative landmarks confirmed ones."""
        self.rows["state"][rows] = LandmarkState.CONFIRMED

    def retire(self, rows: IntArray, reason: RetirementReason) -> None:
        """End the life of landmarks."""
        self.rows["state"][rows] = LandmarkState.RETIRED
        self._reasons.update(dict.fromkeys(rows.tolist(), reason.value))

    def merge(self, kept: int, dropped: int) -> None:
        """Make ``dropped`` a former name of ``kept``: its sightings and labels are added to those of ``kept``.

        Both go by their current names; nothing happens if these are one.
        """
        kept, dropped = self.current(kept), self.current(dropped)
        if kept == dropped:
            return
        landmarks = self.rows
        first_ns = min(landmarks["first_seen_ns"][kept], landmarks["first_seen_ns"][dropped])
        origin = landmarks["first_position_odom"][kept].copy()
        for row in (kept, dropped):
            self._move_origin(row, first_ns, origin)
        for field in ("observations", "sum_t", "sum_tt", "sum_p", "sum_tp"):
            landmarks[field][kept] += landmarks[field][dropped]
        for field in ("last_scan", "last_seen_ns", "last_seen_travel_m"):
            landmarks[field][kept] = max(landmarks[field][kept], landmarks[field][dropped])
        landmarks["first_scan"][kept] = min(landmarks["first_scan"][kept], landmarks["first_scan"][dropped])
        self._label_counts[kept] += self._label_counts[dropped]
        self.retire(np.array([dropped]), RetirementReason.MERGED)
        self._merged_into[dropped] = kept

    def _move_origin(self, row: int, first_ns: int, position: FloatArray) -> None:
        """Make the sums of a landmark relative to another time and place."""
        landmark = self.rows[row : row + 1]
        count = landmark["observations"]
        seconds = (landmark["first_seen_ns"] - first_ns) * 1e-9
        offset = landmark["first_position_odom"] - position
        landmark["sum_tp"] += (
            seconds[:, None] * landmark["sum_p"]
            + offset * landmark["sum_t"][:, None]
            + (count * seconds)[:, None] * offset
        )
        landmark["sum_tt"] += 2.0 * seconds * landmark["sum_t"] + count * seconds**2
        landmark["sum_t"] += count * seconds
        landmark["sum_p"] += count[:, None] * offset
        landmark["first_seen_ns"] = first_ns
        landmark["first_position_odom"] = position

    def current(self, row: int) -> int:
        """The row that a landmark goes by now, after merges."""
        while row in self._merged_into:
            row = self._merged_into[row]
        return row

    def to_record(self, stamp_ns: int) -> ObjectMapRecord:
        """All landmarks in the map frame, as they go into a log; those that never were confirmed are left out."""
        kept = np.array(
            [row for row in range(self._size) if self._reasons.get(row) != RetirementReason.NOT_CONFIRMED],
            dtype=np.int64,
        )
        landmarks = self.rows[kept]
        return ObjectMapRecord(
            stamp_ns=stamp_ns,
            frame_id="map",
            vocabulary=self.vocabulary,
            ids=tuple(str(row) for row in kept),
            positions=landmarks["position_map"].copy(),
            covariances=landmarks["covariance_map"].copy(),
            class_probabilities=self.beliefs(kept),
            states=tuple(LandmarkState(state).name.lower() for state in landmarks["state"]),
            reasons=tuple(self._reason(int(row)) for row in kept),
            observation_counts=landmarks["observations"].copy(),
            first_seen_ns=landmarks["first_seen_ns"].copy(),
            last_seen_ns=landmarks["last_seen_ns"].copy(),
        )

    def _reason(self, row: int) -> str:
        if row in self._merged_into:
            return f"{RetirementReason.MERGED.value} into {self.current(row)}"
        return self._reasons.get(row, "")

    def _reserve(self, size: int) -> None:
        if size <= len(self._rows):
            return
        capacity = max(size, 2 * len(self._rows))
        rows = np.zeros(capacity, dtype=LANDMARK)
        rows[: self._size] = self._rows[: self._size]
        label_counts = np.zeros((capacity, self._label_counts.shape[1]))
        label_counts[: self._size] = self._label_counts[: self._size]
        self._rows, self._label_counts = rows, label_counts
