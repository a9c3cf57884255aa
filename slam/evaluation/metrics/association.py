"""Whether detections were assigned to the landmark of the object that they really show."""

from __future__ import annotations

from collections import Counter, defaultdict, deque
from collections.abc import Collection, Iterable, Mapping
from dataclasses import dataclass

import numpy as np
import pandas as pd

from logs.messages import DetectionAssociations, DetectionTruth
from slam.common.arrays import BoolArray
from slam.common.errors import EvaluationError
from slam.evaluation.inputs.synchronization import PoseSeries
from slam.evaluation.metrics.statistics import fraction

FALSE_POSITIVE = ""
"""True id of a detection that shows no object."""
UNASSIGNED = ""
"""Landmark id of a detection that was given to no landmark."""


@dataclass(frozen=True, slots=True, eq=False)
class LabelledDetections:
    """Detections of the frames in the order of time, one a row of ``table``, which may be empty.

    Its columns: ``frame`` (number), ``travelled_m`` (path length at its time), ``landmark`` and ``object`` (ids), and
    ``created`` (whether it began the landmark).
    """

    table: pd.DataFrame
    frame_count: int
    frames_without_truth: int
    frames_without_associations: int


def label_detections(
    associations: Iterable[DetectionAssociations],
    truths: Iterable[DetectionTruth],
    path: PoseSeries,
    *,
    aliases: Mapping[str, str] | None = None,
) -> LabelledDetections:
    """Join what the estimator said of each detection with what it really shows.

    Args:
        associations: in any order; of several with one stamp, the k-th belongs to the k-th truth with that stamp.
        truths: in any order.
        path: along which the distance between two measurements is measured (odometry or truth).
        aliases: landmark id -> id of the landmark into which it was merged; chains are followed.

    Raises:
        EvaluationError: a frame with truth has another number of associations, or aliases run in a circle.
    """
    surviving = _resolve_aliases(aliases or {})
    truth_at: defaultdict[int, deque[tuple[str, ...]]] = defaultdict(deque)
    for truth in truths:
        truth_at[truth.stamp_ns].append(truth.object_ids)
    stamps: list[int] = []
    rows: list[tuple[int, str, str, bool]] = []
    without_truth = 0
    for frame in sorted(associations, key=lambda record: record.stamp_ns):
        if not truth_at[frame.stamp_ns]:
            without_truth += 1
            continue
        object_ids = truth_at[frame.stamp_ns].popleft()
        if not len(object_ids) == len(frame.landmark_ids) == len(frame.created):
            raise EvaluationError(
                f"the frame at {frame.stamp_ns} ns has {len(frame.landmark_ids)} landmark ids, {len(frame.created)} "
                f"flags and {len(object_ids)} true ids; the ground truth belongs to another log"
            )
        landmark_ids = (surviving.get(name, name) for name in frame.landmark_ids)
        created = (bool(each) for each in frame.created)
        rows += ((len(stamps), *row) for row in zip(landmark_ids, object_ids, created, strict=True))
        stamps.append(frame.stamp_ns)
    table = pd.DataFrame(rows, columns=["frame", "landmark", "object", "created"])
    table = table.astype({"frame": np.int64, "landmark": object, "object": object, "created": np.bool_})
    travelled_m = path.travelled_at_m(np.array(stamps, dtype=np.int64)) if rows else np.zeros(0)
    return LabelledDetections(
        table=table.assign(travelled_m=travelled_m[table["frame"]]),
        frame_count=len(stamps),
        frames_without_truth=without_truth,
        frames_without_associations=sum(len(rest) for rest in truth_at.values()),
    )


def identify_landmarks(table: pd.DataFrame) -> dict[str, str]:
    """True object of each landmark by its id, :data:`FALSE_POSITIVE` for one that shows none.

    It is the object of most of the detections assigned to the landmark, its creation included. False positives
    together count as one candidate. A tie goes to the candidate that the landmark met first.
    """
    assigned = table[table["landmark"] != UNASSIGNED]
    counts = assigned.groupby(["landmark", "object"], sort=False).size()
    best = counts.groupby(level="landmark", sort=False).idxmax()
    return dict(best.tolist())


def find_possible_associations(table: pd.DataFrame, *, revisit_m: float) -> BoolArray:
    """Which detections (N,) show an object that an earlier frame showed at most ``revisit_m`` of travel before."""
    sightings = table[table["object"] != FALSE_POSITIVE].drop_duplicates(["object", "frame"])
    is_recent = sightings.groupby("object")["travelled_m"].diff() <= revisit_m
    recent = pd.MultiIndex.from_frame(sightings.loc[is_recent, ["object", "frame"]])
    return np.asarray(pd.MultiIndex.from_frame(table[["object", "frame"]]).isin(recent), dtype=np.bool_)


def evaluate_associations(
    detections: LabelledDetections,
    *,
    revisit_m: float = 100.0,
    confirmed_landmark_ids: Collection[str] | None = None,
) -> dict[str, float | None]:
    """Precision and recall of the assignments, and how the landmarks split up the objects, by the keys of the JSON.

    * An assignment gives a detection to a landmark that existed (``created`` is false). It is right if the detection
      shows the landmark's true object (:func:`identify_landmarks`); a false positive is never right.
    * An association was possible where the object had been detected in an earlier frame at most ``revisit_m`` of
      travel before; it was made if the detection was assigned to a landmark whose true object it shows.
    * Landmarks per object: over the objects that are the true object of at least one landmark.

    A fraction is None where its denominator is 0.

    Args:
        detections: from :func:`label_detections`; may be empty.
        revisit_m: travel beyond which an object is recognised by a loop closure only.
        confirmed_landmark_ids: those of the final map; None leaves the figures of confirmed landmarks undefined.
    """
    table = detections.table
    identities = identify_landmarks(table)
    real, has_landmark = table["object"] != FALSE_POSITIVE, table["landmark"] != UNASSIGNED
    assigned = has_landmark & ~table["created"]
    right = assigned & real & (table["landmark"].map(identities) == table["object"])
    possible = find_possible_associations(table, revisit_m=revisit_m)
    confirmed = confirmed_false = confirmed_per_object = None
    if confirmed_landmark_ids is not None:
        wanted = set(confirmed_landmark_ids)
        shown = [identity for name, identity in identities.items() if name in wanted]
        confirmed, confirmed_false = len(shown), shown.count(FALSE_POSITIVE)
        confirmed_per_object = fraction(confirmed - confirmed_false, len({*shown} - {FALSE_POSITIVE}))
    per_object = Counter(identity for identity in identities.values() if identity != FALSE_POSITIVE)
    right_count, assigned_count, false_count = int(right.sum()), int(assigned.sum()), int((assigned & ~real).sum())
    possible_count, made_count = int(possible.sum()), int((possible & right).sum())
    return {
        "detection_count": len(table),
        "object_count": table.loc[real, "object"].nunique(),
        "false_positive_count": int((~real).sum()),
        "created_count": int((has_landmark & table["created"]).sum()),
        "assigned_count": assigned_count,
        "right_count": right_count,
        "assigned_false_positive_count": false_count,
        "possible_count": possible_count,
        "made_count": made_count,
        "landmark_count": len(identities),
        "false_landmark_count": len(identities) - per_object.total(),
        "confirmed_landmark_count": confirmed,
        "confirmed_false_landmark_count": confirmed_false,
        "mean_landmarks_per_object": fraction(per_object.total(), len(per_object)),
        "max_landmarks_per_object": max(per_object.values(), default=None),
        "mean_confirmed_landmarks_per_object": confirmed_per_object,
        "frame_count": detections.frame_count,
        "frames_without_truth": detections.frames_without_truth,
        "frames_without_associations": detections.frames_without_associations,
        "precision": fraction(right_count, assigned_count),
        "precision_without_false_positives": fraction(right_count, assigned_count - false_count),
        "recall": fraction(made_count, possible_count),
    }


def count_detections(table: pd.DataFrame) -> dict[str, int]:
    """How often each true object was detected."""
    return {name: int(count) for name, count in table["object"].value_counts().items() if name != FALSE_POSITIVE}


def _resolve_aliases(aliases: Mapping[str, str]) -> dict[str, str]:
    surviving: dict[str, str] = {}
    for start in aliases:
        passed = {start}
        name = aliases[start]
        while name in aliases:
            if name in passed:
                raise EvaluationError(f"landmark {start!r} is merged into itself through {name!r}")
            passed.add(name)
            name = aliases[name]
        surviving[start] = name
    return surviving
