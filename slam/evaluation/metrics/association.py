"""Assignments of detections to the landmark of the object that they show."""

from collections import defaultdict, deque

import numpy as np
import pandas as pd

from slam.common.errors import EvaluationError
from slam.evaluation.inputs.records import EvaluationRecords
from slam.evaluation.metrics.statistics import fraction

FALSE_POSITIVE = ""
"""True id of a detection that shows no object."""
UNASSIGNED = ""
"""Landmark id of a detection that was given to no landmark."""


def label_detections(records: EvaluationRecords) -> pd.DataFrame:
    """Join the landmark that the estimator gave each detection with the object that the detection shows.

    Of several associations with one stamp, the k-th belongs to the k-th truth with that stamp. Landmarks that were
    merged count as the one that stands for them.

    Args:
        records: of the log; the path along which the distance between two measurements is measured is the odometry,
            or else the truth.

    Returns:
        A row a detection, in the order of time: ``frame`` (number), ``travelled_m`` (path length at its time),
        ``landmark`` and ``object`` (ids), ``created`` (whether it began the landmark). Frames without truth are left
        out.

    Raises:
        EvaluationError: associations, truth or path are missing, a frame with truth has another number of
            associations, or none has detections.
    """
    path, object_map = records.odometry_path or records.true_path, records.object_map
    if not records.associations:
        raise EvaluationError("no associations in the log (/slam/associations)")
    if not records.detection_truths:
        raise EvaluationError(
            "no truth of the detections: pass --reference LOG.mcap or record /ground_truth/detections"
        )
    if not path:
        raise EvaluationError("neither odometry nor ground truth, so travel between measurements is unknown")
    merged = zip(object_map.ids, object_map.merged_into, strict=False) if object_map else ()
    aliases = {name: kept for name, kept in merged if kept}
    truth_at: defaultdict[int, deque[tuple[str, ...]]] = defaultdict(deque)
    for truth in records.detection_truths:
        truth_at[truth.stamp_ns].append(truth.object_ids)
    stamps: list[int] = []
    rows: list[tuple[int, str, str, bool]] = []
    for frame in sorted(records.associations, key=lambda record: record.stamp_ns):
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
    if not rows:
        raise EvaluationError(
            f"none of {len(records.associations)} frames has detections with truth: the reference is of another drive"
        )
    table = pd.DataFrame(rows, columns=["frame", "landmark", "object", "created"])
    return table.assign(travelled_m=path.travelled_at_m(np.array(stamps, dtype=np.int64))[table["frame"]])


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
        table: from :func:`label_detections`.
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
