"""The object map: position, class and life cycle of every landmark, as arrays with one row a landmark.

The row of a landmark is its id and never changes. Life cycle: ``TENTATIVE`` from its first observation; ``CONFIRMED``
once it was observed often enough; ``RETIRED`` with a reason if it is not a static object, or a duplicate.
"""

from collections.abc import Set
from enum import IntEnum, StrEnum

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.special import softmax

from logs.messages import ObjectMapRecord
from slam.common.arrays import BoolArray, FloatArray, IntArray
from slam.common.calibration import ObjectCalibration
from slam.common.geometry import unit_vectors


class LandmarkState(IntEnum):
    """State in the life cycle of a landmark."""

    TENTATIVE = 0
    CONFIRMED = 1
    RETIRED = 2


class RetirementReason(StrEnum):
    """Why a landmark was retired."""

    NOT_CONFIRMED = "not_confirmed"
    MOVING = "moving"
    MERGED = "merged"
    CONTRADICTED = "contradicted"
    GONE = "gone"


LANDMARK = np.dtype(
    [
        ("state", np.int8),
        ("reason", f"U{max(map(len, RetirementReason))}"),  # why it was retired, empty before
        ("observations", np.int64),  # detections assigned to it
        ("log_likelihood_ratio", np.float64),  # of all of them but the first, against none of them
        ("first_scan", np.int64),  # numbers of the first and the last scan that saw it
        ("last_scan", np.int64),
        ("first_seen_ns", np.int64),
        ("last_seen_ns", np.int64),
        ("first_seen_travel_m", np.float64),
        ("last_seen_travel_m", np.float64),
        ("segment", np.int64),  # of the odometry: positions of one segment have nothing to do with those of another
        # Where it is relative to the robot: a filter in the odometry frame, which is smooth around the robot.
        ("position_local", np.float64, 3),
        ("covariance_local", np.float64, (3, 3)),
        ("velocity_local", np.float64, 3),  # zero unless it seems to move
        # Where it is in the optimised map.
        ("position_map", np.float64, 3),
        ("covariance_map", np.float64, (3, 3)),
        # Sums over its measurements, of time since the first [s] and of position relative to the first [m].
        ("sum_t", np.float64),
        ("sum_tt", np.float64),
        ("sum_p", np.float64, 3),
        ("sum_tp", np.float64, 3),
        ("first_position_local", np.float64, 3),
        # Sums of its measurements' covariances, and of these times the time and its square.
        ("sum_c", np.float64, (3, 3)),
        ("sum_tc", np.float64, (3, 3)),
        ("sum_ttc", np.float64, (3, 3)),
    ]
)


OTHER_CLASS = "other"
"""The class of objects whose own found no room in the vocabulary."""


class ClassBeliefs:
    """Counts of the labels of each landmark, one row a landmark, and the vocabulary of the labels.

    ``unlisted``: how many labels were of a class beyond the limit; of one class all labels are, on purpose.
    """

    def __init__(self, config: ObjectCalibration) -> None:
        self._config = config
        self.label_counts = np.zeros((64, 8))
        """How often each landmark was given each label; columns beyond the vocabulary are zero."""
        self._label_index: dict[str, int] = {}
        self.vocabulary: tuple[str, ...] = ()
        """Class names in the order in which they were first seen; the index of a label is its place here."""
        self.unlisted = 0

    def indices(self, labels: tuple[str, ...]) -> IntArray:
        """Index (N,) of each label; a new one is added to the vocabulary, while it has room."""
        index, most, indices = self._label_index, self._config.max_classes, list[int]()
        for label in labels:
            # The last class that fits represents all later ones.
            is_listed = label in index or len(index) < most - 1
            indices.append(index.setdefault(label if is_listed else OTHER_CLASS, len(index)))
            self.unlisted += label not in index and most > 1
        self.vocabulary = tuple(index)
        if len(index) > self.label_counts.shape[1]:
            self.reserve(classes=2 * len(index))
        return np.array(indices, dtype=np.int64)

    def reserve(self, *, rows: int = 0, classes: int = 0) -> None:
        """Make room for so many landmarks and classes at least."""
        missing = np.maximum((rows, classes), self.label_counts.shape) - self.label_counts.shape
        self.label_counts = np.pad(self.label_counts, [(0, each) for each in missing.tolist()])

    def beliefs(self, rows: IntArray) -> FloatArray:
        """Class probabilities (N, C) of each landmark."""
        return self.posterior(self.label_counts[rows])

    def classes(self, rows: IntArray) -> IntArray:
        """The most probable class (N,) of each landmark."""
        return self.label_counts[rows].argmax(axis=1)

    def posterior(self, label_counts: FloatArray) -> FloatArray:
        """Class probabilities (N, C): the posterior of even priors and independent labels of the configured accuracy.

        With accuracy p and C classes a label multiplies the odds of its class by p (C - 1) / (1 - p).
        """
        classes = len(self._label_index)
        if classes < 2:
            return np.ones((len(label_counts), classes))
        accuracy = self._config.label_accuracy
        odds = np.log(accuracy * (classes - 1) / (1.0 - accuracy))
        return softmax(label_counts[:, :classes] * odds, axis=1)


class ObjectMap:
    """Landmarks; ``labels``: those that were measured, and the classes that follow."""

    def __init__(self, config: ObjectCalibration) -> None:
        self._rows = np.zeros(64, dtype=LANDMARK)
        self.rows: NDArray[np.void] = self._rows[:0]
        """(L,) structured array of ``LANDMARK``: a view that cannot be written to, another one with more landmarks."""
        self.labels = ClassBeliefs(config)
        self._size = 0
        self._merges: list[tuple[int, int, int | None]] = []  # kept, dropped, and the factor of the closure, if any
        self.canonical = np.zeros(0, dtype=np.int64)
        """The row (L,) of the landmark that each row is in the map: its own, or that of what it was merged into."""
        self.detected_m = -np.inf
        """Travel [m] at the last scan with detections."""

    def __len__(self) -> int:
        return self._size

    def assign(self, rows: IntArray | slice, **fields: ArrayLike) -> None:
        """Set fields of ``LANDMARK`` of landmarks (N,), each to values (N, ...) or to one for all."""
        for name, values in fields.items():
            self._rows[: self._size][name][rows] = values

    def in_state(self, state: LandmarkState) -> IntArray:
        """Rows in that state, ascending; those that became another landmark are left out."""
        return np.flatnonzero((self.rows["state"] == state) & (self.canonical == np.arange(self._size)))

    def add(
        self,
        positions_local: FloatArray,
        covariances_local: FloatArray,
        labels: IntArray,
        *,
        stamp_ns: int,
        scan: int,
        travel_m: float,
        segment: int = 0,
    ) -> IntArray:
        """Make tentative landmarks of detections (N, 3) m with (N, 3, 3) m^2; returns their rows (N,)."""
        new = np.arange(self._size, self._size + len(positions_local))
        self._size += len(positions_local)
        if self._size > len(self._rows):
            capacity = max(self._size, 2 * len(self._rows))
            self._rows = np.append(self._rows, np.zeros(capacity - len(self._rows), dtype=LANDMARK))
            self.labels.reserve(rows=capacity)
        self.canonical = np.concatenate([self.canonical, new])
        self.rows = self._rows[: self._size]
        self.rows.flags.writeable = False
        self.assign(
            new,
            state=LandmarkState.TENTATIVE,
            observations=1,
            first_scan=scan,
            last_scan=scan,
            first_seen_ns=stamp_ns,
            last_seen_ns=stamp_ns,
            first_seen_travel_m=travel_m,
            last_seen_travel_m=travel_m,
            segment=segment,
            position_local=positions_local,
            first_position_local=positions_local,
            covariance_local=covariances_local,
            sum_c=covariances_local,
        )
        self.labels.label_counts[new, labels] += 1.0
        return new

    def restore(
        self, saved: ObjectMapRecord, *, travel_m: float, segment: int = 0, relative_sigma_m: float = 0.0
    ) -> IntArray:
        """Add the landmarks of a prior map, as observed on a segment at ``travel_m``; returns their rows (N,).

        Their positions in the odometry frame are those in the map. The covariances of the map are relative to its
        origin; those between neighbours are far smaller in a map that a robot made.

        Args:
            saved: confirmed landmarks; their probabilities become as many measurements of a class as they had.
            travel_m: when they were observed.
            segment: of the odometry, whose frame is that of the map.
            relative_sigma_m: standard deviation of a coordinate relative to neighbours.
        """
        labels = self.labels.indices(saved.vocabulary)
        rows = self.add(
            saved.positions,
            np.tile(relative_sigma_m**2 * np.eye(3), (len(saved.ids), 1, 1)),
            np.zeros(len(saved.ids), np.int64),
            stamp_ns=0,
            scan=0,
            travel_m=travel_m,
            segment=segment,
        )
        self.assign(
            rows,
            state=LandmarkState.CONFIRMED,
            observations=saved.observation_counts,
            first_seen_ns=saved.first_seen_ns,
            last_seen_ns=saved.last_seen_ns,
            position_map=saved.positions,
            covariance_map=saved.covariances,
        )
        counts = saved.class_probabilities * saved.observation_counts[:, None]
        self.labels.label_counts[rows] = 0.0
        np.add.at(self.labels.label_counts, np.ix_(rows, labels), counts)
        return rows

    def record_observations(
        self,
        rows: IntArray,
        measured_local: FloatArray,
        covariances: FloatArray,
        labels: IntArray,
        log_likelihood_ratios: FloatArray,
        *,
        stamp_ns: int,
        scan: int,
        travel_m: float,
    ) -> None:
        """Count one more measurement of each of ``rows`` (N,), at ``measured_local`` (N, 3) m with ``covariances``
        (N, 3, 3) m^2, with its label (N,) and its log-likelihood ratio (N,) against a detection of no landmark.
        """
        landmarks = self._rows
        seconds = (stamp_ns - landmarks["first_seen_ns"][rows]) * 1e-9
        offset = measured_local - landmarks["first_position_local"][rows]
        self.assign(rows, last_scan=scan, last_seen_ns=stamp_ns, last_seen_travel_m=travel_m)
        landmarks["observations"][rows] += 1
        landmarks["log_likelihood_ratio"][rows] += log_likelihood_ratios
        landmarks["sum_t"][rows] += seconds
        landmarks["sum_tt"][rows] += seconds**2
        landmarks["sum_p"][rows] += offset
        landmarks["sum_tp"][rows] += seconds[:, None] * offset
        for power, name in enumerate(("sum_c", "sum_tc", "sum_ttc")):
            landmarks[name][rows] += (seconds**power)[:, None, None] * covariances
        self.labels.label_counts[rows, labels] += 1.0

    def velocities(self, rows: IntArray) -> tuple[FloatArray, FloatArray]:
        """Apparent velocities (N, 3) m/s of landmarks (N,) in the odometry frame, by the least-squares lines through
        all measurements, and their standard deviations (N,) m/s along them, by the noise of the measurements.
        """
        landmarks = self.rows
        # Field by field, as whole rows are slow to copy.
        count, times = landmarks["observations"][rows], landmarks["sum_t"][rows]
        # Squared deviations [s^2] of the times of the measurements from their mean, at least (1 ms)^2.
        spreads = np.maximum(landmarks["sum_tt"][rows] - times**2 / count, 1e-6)
        slopes = landmarks["sum_tp"][rows] - times[:, None] * landmarks["sum_p"][rows] / count[:, None]
        mean = (times / count)[:, None, None]
        linear = 2.0 * landmarks["sum_tc"][rows] - mean * landmarks["sum_c"][rows]
        squares = landmarks["sum_ttc"][rows] - mean * linear
        along = unit_vectors(slopes)
        variances = np.maximum(np.einsum("ni,nij,nj->n", along, squares, along), 0.0)
        return slopes / spreads[:, None], np.sqrt(variances) / spreads

    def confirm(self, rows: IntArray) -> None:
        """Make tentative landmarks confirmed ones."""
        self._rows["state"][rows] = LandmarkState.CONFIRMED

    @property
    def never_confirmed(self) -> BoolArray:
        """Which landmarks (L,) were retired because they were not observed often enough."""
        return np.asarray(self.rows["reason"] == RetirementReason.NOT_CONFIRMED)

    def retire(self, rows: IntArray, reason: RetirementReason) -> list[int]:
        """Retire landmarks and all that were merged into them; returns the rows of all these, ascending."""
        ended = np.union1d(rows, np.flatnonzero(np.isin(self.canonical, rows)))
        self.assign(ended, state=LandmarkState.RETIRED, reason=reason)
        return ended.tolist()

    def merge(self, kept: int, dropped: int, *, closure: int | None = None) -> None:
        """Make ``dropped`` an alias of ``kept``: in the map they are one landmark from now on.

        Data association still uses both rows, because in the odometry frame the two traversals differ by the drift; the
        record of the map has the sum of their observations.

        Args:
            kept: the row itself, not what it was merged into: other merges may be undone, and this one made again.
            dropped: likewise.
            closure: the factor of the closure that matched the two, if one did.
        """
        first, second = self.canonical[[kept, dropped]].tolist()
        if first != second:
            self.canonical[self.canonical == second] = first
            self._merges.append((kept, dropped, closure))

    def undo_merges(self, closures: Set[int]) -> None:
        """Undo the merges by closures with these factors."""
        merges, self._merges = self._merges, []
        self.canonical = np.arange(self._size)
        for kept, dropped, closure in merges:
            if closure not in closures:
                self.merge(kept, dropped, closure=closure)

    @property
    def aliases(self) -> dict[int, int]:
        """The rows that were merged into another one, with the row that each was merged into."""
        dropped = np.flatnonzero(self.canonical != np.arange(self._size))
        return dict(zip(dropped.tolist(), self.canonical[dropped].tolist(), strict=True))

    def to_record(self, stamp_ns: int) -> ObjectMapRecord:
        """All landmarks in the map frame, as they go into a log; those that never were confirmed are left out.

        The observations of a landmark include those of all that were merged into it.
        """
        kept = np.flatnonzero(~self.never_confirmed)
        landmarks, aliases, rows = self.rows[kept], self.aliases, kept.tolist()
        counts, first, last = (self.rows[name].copy() for name in ("observations", "first_seen_ns", "last_seen_ns"))
        labels = self.labels.label_counts[: self._size].copy()
        dropped, into = list(aliases), list(aliases.values())
        np.add.at(counts, into, counts[dropped])
        np.minimum.at(first, into, first[dropped])
        np.maximum.at(last, into, last[dropped])
        np.add.at(labels, into, labels[dropped])
        landmarks["state"][np.isin(kept, dropped)] = LandmarkState.RETIRED
        return ObjectMapRecord(
            stamp_ns=stamp_ns,
            frame_id="map",
            vocabulary=self.labels.vocabulary,
            ids=tuple(map(str, rows)),
            positions=landmarks["position_map"].copy(),
            covariances=landmarks["covariance_map"].copy(),
            class_probabilities=self.labels.posterior(labels[kept]),
            states=tuple(LandmarkState(state).name.lower() for state in landmarks["state"].tolist()),
            reasons=tuple(
                f"{RetirementReason.MERGED} into {aliases[row]}" if row in aliases else reason
                for row, reason in zip(rows, landmarks["reason"].tolist(), strict=True)
            ),
            merged_into=tuple(str(aliases.get(row, "")) for row in rows) if aliases else (),
            observation_counts=counts[kept],
            first_seen_ns=first[kept],
            last_seen_ns=last[kept],
        )


def shares_but_one(totals: FloatArray, others: FloatArray, shape: tuple[int, int]) -> FloatArray:
    """Shares (...) of classes among L objects but one, of C classes, ``shape`` (L, C).

    ``totals`` (...): objects of the classes; ``others`` (...): the same without the one. The prior has the weight of
    one object (Perks 1947), so that a class that only one object has hardly is another's. One that none has is as
    likely as any.
    """
    count, classes = shape
    return (np.maximum(others, 0.0) + 1.0 / classes) / count + np.maximum(1.0 - totals, 0.0) / classes
