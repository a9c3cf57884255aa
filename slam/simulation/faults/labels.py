"""Faults of the classes of objects."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from itertools import count

import numpy as np

from logs.messages import ObjectDetections
from slam.simulation.faults.stream import HALF, Entry, Stream, alter_detections, labels_of, stamp_at


def draw_labels(stream: Stream, rng: np.random.Generator) -> list[Entry]:
    """Each detection has one of the log's labels, taken at random."""
    labels = labels_of(stream)

    def alter(detections: ObjectDetections) -> ObjectDetections:
        drawn = rng.integers(max(len(labels), 1), size=len(detections.labels)).tolist()
        return replace(detections, labels=tuple(labels[i] for i in drawn))

    return alter_detections(stream, alter)


def number_labels(stream: Stream, rng: np.random.Generator) -> list[Entry]:
    """Each detection has a label of its own."""
    number = count()
    return alter_detections(
        stream,
        lambda detections: replace(detections, labels=tuple(f"object_{next(number)}" for _ in detections.labels)),
    )


def use_one_label(stream: Stream, rng: np.random.Generator) -> list[Entry]:
    """All detections have the same label."""
    return _relabelled(stream, lambda label: "object", from_ns=0)


def change_case(stream: Stream, rng: np.random.Generator) -> list[Entry]:
    """From the half on, labels are written in capitals."""
    return _relabelled(stream, str.upper, from_ns=stamp_at(stream, HALF))


def permute_labels(stream: Stream, rng: np.random.Generator) -> list[Entry]:
    """From the half on, each label stands for another one's objects."""
    labels = labels_of(stream)
    order = rng.permutation(len(labels)).tolist()
    # Along a cycle through all of them no label keeps its meaning.
    meaning = {labels[a]: labels[b] for a, b in zip(order, order[1:] + order[:1], strict=True)}
    return _relabelled(stream, lambda label: meaning[label], from_ns=stamp_at(stream, HALF))


def _relabelled(stream: Stream, rename: Callable[[str], str], *, from_ns: int) -> list[Entry]:
    def alter(detections: ObjectDetections) -> ObjectDetections:
        if detections.stamp_ns < from_ns:
            return detections
        return replace(detections, labels=tuple(rename(label) for label in detections.labels))

    return alter_detections(stream, alter)
