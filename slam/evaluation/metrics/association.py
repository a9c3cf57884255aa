"""Whether detections were assigned to the landmark of the object that they really show."""

from __future__ import annotations

from collections import defaultdict, deque
from collections.abc import Collection, Iterable, Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from logs.messages import DetectionAssociations, DetectionTruth
from slam.common.arrays import FloatArray, IntArray
from slam.common.errors import EvaluationError
from slam.evaluation.inputs.synchronization import PoseSeries

FALSE_POSITIVE = ""
"""True id of a detection that shows no object."""
UNASSIGNED = ""
"""Landmark id of a detection that was given to no landmark."""


@dataclass(frozen=True, slots=True, eq=False)
class LabelledDetections:
    """Detections of M frames in the order of time, flat: each array has one entry a detection, N may be 0.

    frames (N,) non-decreasing index of the frame; travelled_m (N,) path length at its time; landmarks and objects (N,)
    index into ``landmark_ids`` and ``object_ids``, -1 for none (no landmark; false positive); created (N,) bool.
    """

    frames: IntArray
    travelled_m: FloatArray
    landmarks: IntArray
    objects: IntArray
    created: NDArray[np.bool_]
    landmark_ids: tuple[str, ...]
    object_ids: tuple[str, ...]
    frame_count: int
    frames_without_truth: int
    frames_without_associations: int


@dataclass(frozen=True, slots=True, eq=False)
class AssociationQuality:
    """Counts, and the fractions made of them; a fraction is None where its denominator is 0.

    ``landmark_object_ids`` gives each landmark its true object ("" for a false positive),
    ``object_detection_counts`` how often each true object was detected.
    """

    detection_count: int
    false_positive_count: int
    created_count: int
    assigned_count: int
    right_count: int
    assigned_false_positive_count: int
    possible_count: int
    made_count: int
    landmark_count: int
    false_landmark_count: int
    confirmed_landmark_count: int | None
    confirmed_false_landmark_count: int | None
    mean_landmarks_per_object: float | None
    max_landmarks_per_object: int | None
    mean_confirmed_landmarks_per_object: float | None
    frame_count: int
    frames_without_truth: int
    frames_without_associations: int
    landmark_object_ids: Mapping[str, str]
    object_detection_counts: Mapping[str, int]

    @property
    def precision(self) -> float | None:
        """Right assignments among all to an existing landmark; an assigned false positive is wrong."""
        return _fraction(self.right_count, self.assigned_count)

    @property
    def precision_without_false_positives(self) -> float | None:
        """As :attr:`precision`, among the assigned detections that show an object."""
        return _fraction(self.right_count, self.assigned_count - self.assigned_false_positive_count)

    @property
    def recall(self) -> float | None:
        """Associations made among those that were possible."""
        return _fraction(self.made_count, self.possible_count)


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
    sizes: list[int] = []
    landmark_names: list[str] = []
    object_names: list[str] = []
    created: list[NDArray[np.bool_]] = []
    without_truth = 0
    for frame in sorted(associations, key=lambda record: record.stamp_ns):
        if not truth_at[frame.stamp_ns]:
            without_truth += 1
            continue
        object_ids = truth_at[frame.stamp_ns].popleft()
        if not len(object_ids) == len(frame.landmark_ids) == len(frame.created):
            raise EvaluationError(
                f"the frame at {frame.stamp_ns} ns has {len(frame.landmark_ids)} landmark ids, {len(frame.created)} "
                f"flags and {len(object_ids)} true ids; the truth is not of this log"
            )
        stamps.append(frame.stamp_ns)
        sizes.append(len(object_ids))
        landmark_names.extend(surviving.get(name, name) for name in frame.landmark_ids)
        object_names.extend(object_ids)
        created.append(np.asarray(frame.created, dtype=np.bool_))
    frames = np.repeat(np.arange(len(stamps)), sizes).astype(np.int64)
    stamps_ns = np.array(stamps, dtype=np.int64)
    landmarks, landmark_ids = _encode(landmark_names)
    objects, object_ids = _encode(object_names)
    return LabelledDetections(
        frames=frames,
        travelled_m=path.travelled_at_m(stamps_ns)[frames] if len(frames) else np.zeros(0),
        landmarks=landmarks,
        objects=objects,
        created=np.concatenate([np.zeros(0, dtype=np.bool_), *created]),
        landmark_ids=landmark_ids,
        object_ids=object_ids,
        frame_count=len(stamps),
        frames_without_truth=without_truth,
        frames_without_associations=sum(len(rest) for rest in truth_at.values()),
    )


def identify_landmarks(detections: LabelledDetections) -> IntArray:
    """True object (L,) of each landmark as index into ``object_ids``, -1 for a false positive.

    It is the object of most of the detections assigned to the landmark, its creation included. False positives
    together count as one candidate. A tie goes to the candidate that the landmark met first.
    """
    assigned = np.flatnonzero(detections.landmarks >= 0)
    candidates = len(detections.object_ids) + 1
    pairs = detections.landmarks[assigned] * candidates + (detections.objects[assigned] + 1)
    unique, first, counts = np.unique(pairs, return_index=True, return_counts=True)
    landmarks, objects = unique // candidates, unique % candidates - 1
    # The best of each landmark comes first: by landmark, then falling count, then the earliest.
    order = np.lexsort((first, -counts, landmarks))
    best = order[np.unique(landmarks[order], return_index=True)[1]]
    identities = np.full(len(detections.landmark_ids), -1, dtype=np.int64)
    identities[landmarks[best]] = objects[best]
    return identities


def find_possible_associations(detections: LabelledDetections, *, revisit_m: float) -> NDArray[np.bool_]:
    """Which detections (N,) show an object that an earlier frame showed at most ``revisit_m`` of travel before."""
    possible = np.zeros(len(detections.frames), dtype=np.bool_)
    real = np.flatnonzero(detections.objects >= 0)
    if len(real) == 0:
        return possible
    frame_span = int(detections.frames[-1]) + 1
    measurements, first, of_sighting = np.unique(
        detections.objects[real] * frame_span + detections.frames[real], return_index=True, return_inverse=True
    )
    objects = measurements // frame_span
    travelled = detections.travelled_m[real[first]]
    seen_before = np.zeros(len(measurements), dtype=np.bool_)
    seen_before[1:] = (objects[1:] == objects[:-1]) & (np.diff(travelled) <= revisit_m)
    possible[real] = seen_before[of_sighting]
    return possible


def evaluate_associations(
    detections: LabelledDetections,
    *,
    revisit_m: float = 100.0,
    confirmed_landmark_ids: Collection[str] | None = None,
) -> AssociationQuality:
    """Precision and recall of the assignments, and how the landmarks split up the objects.

    * An assignment gives a detection to a landmark that existed (``created`` is false). It is right if the detection
      shows the landmark's true object (:func:`identify_landmarks`); a false positive is never right.
    * An association was possible where the object had been detected in an earlier frame at most ``revisit_m`` of
      travel before; it was made if the detection was assigned to a landmark whose true object it shows.
    * Landmarks per object: over the objects that are the true object of at least one landmark.

    Args:
        detections: from :func:`label_detections`; may be empty.
        revisit_m: travel beyond which an object is recognised by a loop closure only.
        confirmed_landmark_ids: those of the final map; None leaves the figures of confirmed landmarks undefined.
    """
    identities = identify_landmarks(detections)
    real = detections.objects >= 0
    assigned = (detections.landmarks >= 0) & ~detections.created
    right = assigned & real
    right[right] = identities[detections.landmarks[right]] == detections.objects[right]
    possible = find_possible_associations(detections, revisit_m=revisit_m)
    names = (*detections.object_ids, FALSE_POSITIVE)  # Index -1 is the last.
    per_object = np.bincount(identities[identities >= 0])
    per_object = per_object[per_object > 0]
    confirmed: IntArray | None = None
    if confirmed_landmark_ids is not None:
        wanted = set(confirmed_landmark_ids)
        is_confirmed = np.array([name in wanted for name in detections.landmark_ids], dtype=np.bool_)
        confirmed = identities[is_confirmed]
    detection_counts = np.bincount(detections.objects[real], minlength=len(detections.object_ids))
    return AssociationQuality(
        detection_count=len(detections.frames),
        false_positive_count=int(np.count_nonzero(~real)),
        created_count=int(np.count_nonzero(detections.created & (detections.landmarks >= 0))),
        assigned_count=int(np.count_nonzero(assigned)),
        right_count=int(np.count_nonzero(right)),
        assigned_false_positive_count=int(np.count_nonzero(assigned & ~real)),
        possible_count=int(np.count_nonzero(possible)),
        made_count=int(np.count_nonzero(possible & right)),
        landmark_count=len(identities),
        false_landmark_count=int(np.count_nonzero(identities < 0)),
        confirmed_landmark_count=None if confirmed is None else len(confirmed),
        confirmed_false_landmark_count=None if confirmed is None else int(np.count_nonzero(confirmed < 0)),
        mean_landmarks_per_object=float(per_object.mean()) if len(per_object) else None,
        max_landmarks_per_object=int(per_object.max()) if len(per_object) else None,
        mean_confirmed_landmarks_per_object=None if confirmed is None else _mean_per_object(confirmed),
        frame_count=detections.frame_count,
        frames_without_truth=detections.frames_without_truth,
        frames_without_associations=detections.frames_without_associations,
        landmark_object_ids={
            name: names[identity] for name, identity in zip(detections.landmark_ids, identities, strict=True)
        },
        object_detection_counts=dict(zip(detections.object_ids, detection_counts.tolist(), strict=True)),
    )


def _encode(names: list[str]) -> tuple[IntArray, tuple[str, ...]]:
    """Index (N,) of each name in order of first appearance, -1 for ""; and the names."""
    index: dict[str, int] = {"": -1}
    codes = [index.setdefault(name, len(index) - 1) for name in names]
    return np.array(codes, dtype=np.int64), tuple(name for name in index if name)


def _resolve_aliases(aliases: Mapping[str, str]) -> dict[str, str]:
    surviving: dict[str, str] = {}
    for start in aliases:
        passed = {start}
        name = aliases[start]
        while name in aliases:
            if name in passed:
                raise EvaluationError(f"landmark {start!r} is merged in a circle through {name!r}")
            passed.add(name)
            name = aliases[name]
        surviving[start] = name
    return surviving


def _mean_per_object(identities: IntArray) -> float | None:
    real = identities[identities >= 0]
    return len(real) / len(np.unique(real)) if len(real) else None


def _fraction(part: int, whole: int) -> float | None:
    return part / whole if whole else None
