"""Faults of the classes of objects."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from itertools import count

import numpy as np

from logs.messages import ObjectDetections
from slam.simulation.faults.fault import DETECTIONS, ODOMETRY, fault
from slam.simulation.faults.stream import HALF, Entry, Stream, alter_detections, labels_of, stamp_at


@fault(DETECTIONS)
def labels_random(stream: Stream, *, rng: np.random.Generator) -> list[Entry]:
    """Each detection has a label of the log drawn at random."""
    labels = labels_of(stream)

    def alter(detections: ObjectDetections) -> ObjectDetections:
        drawn = rng.integers(max(len(labels), 1), size=len(detections.labels)).tolist()
        return replace(detections, labels=tuple(labels[i] for i in drawn))

    return alter_detections(stream, alter)


@fault(DETECTIONS)
def labels_unique(stream: Stream) -> list[Entry]:
    """Each detection has a label of its own."""
    number = count()
    return alter_detections(
        stream,
        lambda detections: replace(detections, labels=tuple(f"object_{next(number)}" for _ in detections.labels)),
    )


@fault(DETECTIONS)
def labels_one_class(stream: Stream) -> list[Entry]:
    """All detections have one label."""
    return _relabelled(stream, lambda label: "object", from_ns=0)


@fault(DETECTIONS, reads=ODOMETRY)
def labels_case(stream: Stream) -> list[Entry]:
    """Labels are in capitals from half time on."""
    return _relabelled(stream, str.upper, from_ns=stamp_at(stream, HALF))


@fault(DETECTIONS, reads=ODOMETRY)
def labels_permuted(stream: Stream, *, rng: np.random.Generator) -> list[Entry]:
    """From half time on each label stands for objects of another one."""
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
