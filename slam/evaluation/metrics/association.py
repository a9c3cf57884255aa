"""Assignments of detections to the landmark of the object that they show."""

from collections import defaultdict, deque
from collections.abc import Iterable, Mapping

import numpy as np
import pandas as pd

from logs.messages import DetectionAssociations, DetectionTruth, ObjectMapRecord
from slam.common.errors import EvaluationError
from slam.evaluation.inputs.synchronization import PoseSeries
from slam.evaluation.metrics.statistics import fraction

FALSE_POSITIVE = ""
"""True id of a detection that shows no object."""
UNASSIGNED = ""
"""Landmark id of a detection that was given to no landmark."""


def find_aliases(object_map: ObjectMapRecord | None) -> dict[str, str]:
    """Id of each merged landmark -> id of the one that stands for it."""
    if object_map is None:
        return {}
    return {name: kept for name, kept in zip(object_map.ids, object_map.merged_into, strict=False) if kept}


def label_detections(
    associations: Iterable[DetectionAssociations],
    truths: Iterable[DetectionTruth],
    path: PoseSeries,
    *,
    aliases: Mapping[str, str],
) -> pd.DataFrame:
    """Join the landmark that the estimator gave each detection with the object that the detection shows.

    Args:
        associations: in any order; of several with one stamp, the k-th belongs to the k-th truth with that stamp.
        truths: in any order.
        path: along which the distance between two measurements is measured (odometry or truth).
        aliases: landmark id -> id of the landmark into which it was merged.

    Returns:
        A row a detection, in the order of time: ``frame`` (number), ``travelled_m`` (path length at its time),
        ``landmark`` and ``object`` (ids), ``created`` (whether it began the landmark). Frames without truth are left
        out.

    Raises:
        EvaluationError: a frame with truth has another number of associations.
    """
    truth_at: defaultdict[int, deque[tuple[str, ...]]] = defaultdict(deque)
    for truth in truths:
        truth_at[truth.stamp_ns].append(truth.object_ids)
    stamps: list[int] = []
    rows: list[tuple[int, str, str, bool]] = []
    for frame in sorted(associations, key=lambda record: record.stamp_ns):
        if not truth_at[frame.stamp_ns]:
            continue
        object_ids = truth_at[frame.stamp_ns].popleft()
        if not len(object_ids) == len(frame.landmark_ids) == len(frame.created):
            raise EvaluationError(
                f"the frame at {frame.stamp_ns} ns has {len(frame.landmark_ids)} landmark ids, {len(frame.created)} "
                f"flags and {len(object_ids)} true ids; the ground truth belongs to another log"
            )
        landmark_ids = (aliases.get(name, name) for name in frame.landmark_ids)
        rows += ((len(stamps), *row) for row in zip(landmark_ids, object_ids, frame.created.tolist(), strict=True))
        stamps.append(frame.stamp_ns)
    table = pd.DataFrame(rows, columns=["frame", "landmark", "object", "created"])
    table = table.astype({"frame": np.int64, "landmark": object, "object": object, "created": np.bool_})
    travelled_m = path.travelled_at_m(np.array(stamps, dtype=np.int64))
    return table.assign(travelled_m=travelled_m[table["frame"]])


def identify_landmarks(table: pd.DataFrame) -> dict[str, str]:
    """True object of each landmark by its id, :data:`FALSE_POSITIVE` for one that shows none.

    It is the object of most of the detections assigned to the landmark, its creation included. False positives
    together count as one candidate. A tie goes to the candidate that the landmark met first.
    """
    assigned = table[table["landmark"] != UNASSIGNED]
    counts = assigned.groupby(["landmark", "object"], sort=False).size()
    best = counts.groupby(level="landmark", sort=False).idxmax()
    return dict(best.tolist())


def evaluate_associations(table: pd.DataFrame, *, revisit_m: float = 100.0) -> dict[str, float | None]:
    """Precision and recall of the assignments, by the keys of the JSON.

    * An assignment gives a detection to a landmark that existed (``created`` is false). It is right if the detection
      shows the landmark's true object (:func:`identify_landmarks`); a false positive is never right.
    * An association was possible where the object had been detected in an earlier frame at most ``revisit_m`` of
      travel before; it was made if the detection was assigned to a landmark whose true object it shows.

    A fraction is None where its denominator is 0.

    Args:
        table: from :func:`label_detections`; may be empty.
        revisit_m: travel beyond which an object is recognised by a loop closure only.
    """
    assigned, is_object = (table["landmark"] != UNASSIGNED) & ~table["created"], table["object"] != FALSE_POSITIVE
    right = assigned & is_object & (table["landmark"].map(identify_landmarks(table)) == table["object"])
    sightings = table[is_object].drop_duplicates(["object", "frame"])
    recent = sightings[sightings.groupby("object")["travelled_m"].diff() <= revisit_m]
    possible = pd.MultiIndex.from_frame(table[["object", "frame"]]).isin(
        pd.MultiIndex.from_frame(recent[["object", "frame"]])
    )
    counts = {
        "detection_count": len(table),
        "assigned_count": assigned.sum(),
        "right_count": right.sum(),
        "possible_count": possible.sum(),
        "made_count": (possible & right).sum(),
    }
    precision = fraction(counts["right_count"], counts["assigned_count"])
    return {**counts, "precision": precision, "recall": fraction(counts["made_count"], counts["possible_count"])}


def count_detections(table: pd.DataFrame) -> dict[str, int]:
    """Number of detections of each true object."""
    return dict(table["object"][table["object"] != FALSE_POSITIVE].value_counts())
