"""The classes of landmarks, from the labels that were measured."""

from __future__ import annotations

import numpy as np
from scipy.special import softmax

from slam.common.arrays import FloatArray, IntArray
from slam.common.calibration import ObjectCalibration

OTHER_CLASS = "other"
"""The class of objects whose own found no room in the vocabulary."""


class ClassBeliefs:
    """Counts of the labels of each landmark, one row a landmark, and the vocabulary of the labels.

    ``unlisted``: how many labels were of a class beyond the limit; of one class all labels are, on purpose.
    """

    def __init__(self, config: ObjectCalibration) -> None:
        self._config = config
        self._label_counts = np.zeros((64, 8))
        self._label_index: dict[str, int] = {}
        self.unlisted = 0

    @property
    def vocabulary(self) -> tuple[str, ...]:
        """Class names in the order in which they were first seen; the index of a label is its place here."""
        return tuple(self._label_index)

    def indices(self, labels: tuple[str, ...]) -> IntArray:
        """Index (N,) of each label; a new one is added to the vocabulary, while it has room."""
        for label in labels:
            # The last class that fits represents all later ones.
            is_listed = label in self._label_index or len(self._label_index) < self._config.max_classes - 1
            self._label_index.setdefault(label if is_listed else OTHER_CLASS, len(self._label_index))
        if len(self._label_index) > self._label_counts.shape[1]:
            self.reserve(classes=2 * len(self._label_index))
        other = self._label_index.get(OTHER_CLASS, 0)
        indices = np.array([self._label_index.get(label, other) for label in labels], dtype=np.int64)
        if self._config.max_classes > 1:
            self.unlisted += sum(label not in self._label_index for label in labels)
        return indices

    def reserve(self, *, rows: int = 0, classes: int = 0) -> None:
        """Make room for so many landmarks and classes at least."""
        counts = self._label_counts
        self._label_counts = np.zeros((max(rows, counts.shape[0]), max(classes, counts.shape[1])))
        self._label_counts[: counts.shape[0], : counts.shape[1]] = counts

    def count(self, rows: IntArray, labels: IntArray) -> None:
        """Count one more label (N,) of each of different landmarks (N,)."""
        self._label_counts[rows, labels] += 1.0

    def restore(self, rows: IntArray, labels: IntArray, counts: FloatArray) -> None:
        """Set how often landmarks (N,) were given labels (C,), (N, C)."""
        self._label_counts[rows] = 0.0
        np.add.at(self._label_counts, np.ix_(rows, labels), counts)

    def label_counts(self, rows: IntArray | int | slice) -> FloatArray:
        """Counts of the labels of landmarks; columns beyond the vocabulary are zero."""
        return self._label_counts[rows]

    def beliefs(self, rows: IntArray) -> FloatArray:
        """Class probabilities (N, C) of each landmark."""
        return self.posterior(self._label_counts[rows])

    def classes(self, rows: IntArray) -> IntArray:
        """The most probable class (N,) of each landmark."""
        if not self._label_index:
            return np.zeros(len(rows), dtype=np.int64)
        return np.asarray(self._label_counts[rows, : len(self._label_index)].argmax(axis=1))

    def posterior(self, label_counts: FloatArray) -> FloatArray:
        """Class probabilities (N, C): the posterior of even priors and independent labels of the configured accuracy.

        With accuracy p and C classes a label multiplies the odds of its class by p (C - 1) / (1 - p).
        """
        classes = len(self._label_index)
        if classes < 2:
            return np.ones((len(label_counts), classes))
        accuracy = self._config.label_accuracy
        odds = np.log(accuracy * (classes - 1) / (1.0 - accuracy))
        return np.asarray(softmax(label_counts[:, :classes] * odds, axis=1))
