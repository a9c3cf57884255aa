"""Faults of the classes of objects."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from itertools import count

import numpy as np

from logs.messages import ObjectDetections
from slam.simulation.faults.fault import DETECTIONS, ODOMETRY, detection_fault, fault
from slam.simulation.faults.stream import HALF, Entry, Stream, alter_detections, labels_of, stamp_at


@fault(DETECTIONS)
def labels_random(stream: Stream, *, rng: np.random.Generator) -> list[Entry]:
    """Each detection has a label of the log drawn at random."""
    labels = np.array(labels_of(stream), dtype=np.object_)
    return alter_detections(
        stream,
        lambda seen: replace(
            seen, labels=tuple(labels[rng.integers(max(len(labels), 1), size=len(seen.labels))].tolist())
        ),
    )


@fault(DETECTIONS)
def labels_unique(stream: Stream) -> list[Entry]:
    """Each detection has a label of its own."""
    number = count()
    return alter_detections(
        stream, lambda seen: replace(seen, labels=tuple(f"object_{next(number)}" for _ in seen.labels))
    )


@detection_fault()
def labels_one_class(seen: ObjectDetections) -> ObjectDetections:
    """All detections have one label."""
    return replace(seen, labels=("object",) * len(seen.labels))


@fault(DETECTIONS, reads=ODOMETRY)
def labels_case(stream: Stream) -> list[Entry]:
    """Labels are in capitals from half time on."""
    return _relabelled(stream, str.upper)


@fault(DETECTIONS, reads=ODOMETRY)
def labels_permuted(stream: Stream, *, rng: np.random.Generator) -> list[Entry]:
    """From half time on each label stands for objects of another one."""
    labels = labels_of(stream)
    order = rng.permutation(len(labels)).tolist()
    # Along a cycle through all of them no label keeps its meaning.
    meaning = {labels[a]: labels[b] for a, b in zip(order, order[1:] + order[:1], strict=True)}
    return _relabelled(stream, meaning.__getitem__)


def _relabelled(stream: Stream, rename: Callable[[str], str]) -> list[Entry]:
    """The stream with other labels from half time on."""
    from_ns = stamp_at(stream, HALF)

    def alter(seen: ObjectDetections) -> ObjectDetections:
        return seen if seen.stamp_ns < from_ns else replace(seen, labels=tuple(map(rename, seen.labels)))

    return alter_detections(stream, alter)
