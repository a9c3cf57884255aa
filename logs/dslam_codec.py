"""``dslam.*`` messages <-> records: one table of the shapes of their arrays serves both directions."""

import dataclasses
import math
from collections import Counter
from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple, TypeVar

import numpy as np
from google.protobuf.descriptor import FieldDescriptor
from google.protobuf.message import Message
from numpy.typing import NDArray

from logs import messages as m
from logs.schemas import dslam_pb2 as pb
from logs.topics import RecordKind
from logs.validation import LAST_NS, MAX_COORDINATE_M, Refusal, flat_array, transforms, usable_covariance

_Record = TypeVar("_Record", bound="m.ObjectDetections | m.ObjectMapRecord | m.FactorGraphRecord")


_MESSAGE_FIELDS = {"T_map_body": "map_body", "T_reference_query": "reference_query", "edge_transforms": "edge_from_to"}
"""Name in the record -> name in the message, where they differ."""

_DTYPES: Mapping[int, Any] = {
    FieldDescriptor.CPPTYPE_INT64: np.int64,
    FieldDescriptor.CPPTYPE_DOUBLE: np.float64,
    FieldDescriptor.CPPTYPE_BOOL: np.bool_,
}
"""Type of a field -> that of its array in a record; text is in tuples."""


class _Field(NamedTuple):
    """A field of a record and of its message; ``lengths`` and ``dtype`` of its array or tuple."""

    name: str
    lengths: list[str]
    dtype: Any
    described: FieldDescriptor


class Codec:
    """Translates one kind of record into its message, and back; ``kinds``: what it may be on a topic.

    ``shapes``: of each field that is an array or a tuple its lengths, as numbers, or as letters that stand for one
    length in the whole message, which the first field with that letter sets, and "T" for a transform; with "?" it may
    be empty, and the record then has its default.
    """

    def __init__(self, record: type, message_class: Any, *kinds: RecordKind, **shapes: str) -> None:
        self.message_class = message_class
        self.record = record
        self.kinds = kinds
        self.shapes = shapes | {f.name: "" for f in dataclasses.fields(record) if f.name not in shapes}
        self._fields = []
        for name, shape in self.shapes.items():
            described = message_class.DESCRIPTOR.fields_by_name[_MESSAGE_FIELDS.get(name, name)]
            dtype = _DTYPES.get(described.cpp_type)
            self._fields.append(_Field(name, shape.rstrip("?").split(), dtype, described))

    def encode(self, record: Any) -> Message:
        """The message of ``record``; what is None is not set."""
        values = {}
        for field in self._fields:
            value = getattr(record, field.name)
            if isinstance(value, np.ndarray):
                value = (value[..., :3, :] if "T" in field.lengths else value).ravel().tolist()
            values[field.described.name] = value
        message: Message = self.message_class(**values)
        return message

    def decode(self, message: Any, counters: Counter[str]) -> Any:
        """The record of ``message``, whose numbers may be any; ``counters`` counts covariances that are left out.

        Raises:
            Refusal: lengths that disagree, or a matrix that is no rotation.
        """
        values = {}
        lengths = {"T": 12}  # numbers of a transform
        for field in self._fields:
            value = getattr(message, field.described.name)
            if field.lengths:
                if len(value) or not self.shapes[field.name].endswith("?"):
                    values[field.name] = _shaped(value, field, lengths, counters)
            elif field.described.is_repeated:  # a map in any order; sorted, a record is the same in every run
                values[field.name] = dict(sorted(value.items()))
            elif not field.described.has_presence or message.HasField(field.described.name):
                values[field.name] = value
        return self.record(**values)


def _shaped(values: Sequence[Any], field: _Field, lengths: dict[str, int], counters: Counter[str]) -> Any:
    """The array or the tuple in ``values``; ``lengths`` by letter, to which the first of ``field`` is added.

    Raises:
        Refusal: another length, a matrix that is no rotation, or numbers that no record may have.
    """
    (first, *others), name = field.lengths, field.name
    if first == "T":
        return transforms(values, 1, name)[0]
    if first == "6":
        return usable_covariance(flat_array(values, (6, 6), name), counters)
    width = [int(each) if each.isdecimal() else lengths[each] for each in others]
    if first not in lengths:
        lengths[first] = len(values) // max(math.prod(width), 1)
    count = lengths[first]
    if "T" in others:
        return transforms(values, count, name)
    if field.dtype is not None:
        return flat_array(values, (count, *width), name, field.dtype)
    if len(values) != count:
        raise Refusal("lengths disagree", f"{name}: {len(values)} for {count}")
    return tuple(values)


def check_arrays(record: Any) -> None:
    """See that the arrays of a record hold what they may.

    Raises:
        Refusal: numbers that no record may have.
    """
    for field in dataclasses.fields(record):
        name, array = field.name, getattr(record, field.name)
        if not isinstance(array, np.ndarray):
            continue
        if array.dtype == np.float64:
            if not np.isfinite(array).all():
                raise Refusal("number is not finite", name)
            # More than the variance of the farthest place, seen in a direction that is unknown in many steps.
            if (np.abs(array) > (1e3 * MAX_COORDINATE_M) ** 2).any():
                raise Refusal("number is out of range", name)
        elif name.endswith("_ns") and len(array):
            earliest_ns = -1 if name == "keyframe_stamps_ns" else 0  # keyframes of a prior map have no time
            if not earliest_ns <= array.min() <= array.max() <= LAST_NS:
                raise Refusal("time out of range", name)


CODECS: Mapping[type, Codec] = {
    codec.record: codec
    for codec in (
        Codec(
            m.ObjectDetections,
            pb.ObjectDetections,
            RecordKind.DETECTIONS,
            labels="N",
            positions="N 3",
            scores="N",
            covariances="N 3 3?",
        ),
        Codec(m.DetectionTruth, pb.DetectionTruth, RecordKind.DETECTION_TRUTH, object_ids="N"),
        Codec(
            m.DetectionAssociations, pb.DetectionAssociations, RecordKind.ASSOCIATIONS, landmark_ids="N", created="N"
        ),
        Codec(
            m.ObjectMapRecord,
            pb.ObjectMap,
            RecordKind.OBJECT_MAP,
            RecordKind.OBJECT_TRUTH,
            ids="N",
            vocabulary="C",
            positions="N 3",
            covariances="N 3 3",
            class_probabilities="N C",
            states="N",
            reasons="N",
            observation_counts="N",
            first_seen_ns="N",
            last_seen_ns="N",
            merged_into="N?",
        ),
        Codec(m.TrajectoryRecord, pb.Trajectory, RecordKind.TRAJECTORY, stamps_ns="N", T_map_body="N T"),
        Codec(
            m.FactorGraphRecord,
            pb.FactorGraph,
            RecordKind.FACTOR_GRAPH,
            keyframe_ids="K",
            keyframe_stamps_ns="K",
            T_map_body="K T",
            edge_kinds="E",
            edge_keyframe_ids="E 2",
            edge_transforms="E T",
            edge_covariances="E 6 6",
            observation_landmark_ids="O",
            observation_keyframe_ids="O",
            observation_positions="O 3",
            observation_covariances="O 3 3",
            pose_covariances="K 6 6?",
            observation_redundancies="O?",
        ),
        Codec(m.LoopClosureRecord, pb.LoopClosure, RecordKind.LOOP_CLOSURES, T_reference_query="T?", covariance="6 6?"),
        Codec(m.StatusRecord, pb.Status, RecordKind.STATUS),
        Codec(
            m.LocalizationRecord,
            pb.Localization,
            RecordKind.LOCALIZATION,
            sources="S",
            innovation_ratios="S",
            covariance="6 6?",
        ),
    )
}


def take_rows(record: _Record, **rows: NDArray[np.int64]) -> _Record:
    """The record with only some rows (K,) of all that has the length with that letter, as ``CODECS`` names it."""
    taken: dict[str, Any] = {}
    for name, shape in CODECS[type(record)].shapes.items():
        kept, values = rows.get(shape[:1]), getattr(record, name)
        if kept is not None and values is not None and len(values):
            is_text = isinstance(values, tuple)
            taken[name] = tuple(values[row] for row in kept.tolist()) if is_text else values[kept]
    return dataclasses.replace(record, **taken)
