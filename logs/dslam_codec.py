"""``dslam.*`` messages <-> records: one table of the shapes of their arrays serves both directions."""

import dataclasses
import math
from collections import Counter
from collections.abc import Mapping, Sequence
from typing import Any, TypeVar

import numpy as np
from google.protobuf.descriptor import FieldDescriptor
from google.protobuf.message import Message
from numpy.typing import NDArray

from logs import messages as m
from logs.schemas import dslam_pb2 as pb
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


class _Field:
    """A field of a record and of its message.

    ``shape``: the lengths of an array or a tuple, as numbers or as letters that stand for one length in the whole
    message, and "T" for a transform; with "?" it may be empty, and the record then has its default.
    """

    def __init__(self, name: str, message_field: FieldDescriptor, shape: str) -> None:
        self.name = name
        self.message_name = message_field.name
        self.lengths = shape.rstrip("?").split()
        self.is_map = message_field.is_repeated and not shape
        self.is_optional = message_field.has_presence
        self.may_be_empty = shape.endswith("?")
        self._dtype = _DTYPES.get(message_field.cpp_type)

    def encode(self, value: Any) -> Any:
        """What the message holds of ``value``, which is not None."""
        if not isinstance(value, np.ndarray):
            return value
        return (value[..., :3, :] if "T" in self.lengths else value).ravel().tolist()

    def decode(self, values: Sequence[Any], lengths: dict[str, int], counters: Counter[str]) -> Any:
        """The array or the tuple in ``values``; ``lengths`` by letter, to which the first of this field is added.

        Raises:
            Refusal: another length, a matrix that is no rotation, or numbers that no record may have.
        """
        first, *others = self.lengths
        if first == "T":
            return transforms(values, 1, self.name)[0]
        if first == "6":
            return usable_covariance(flat_array(values, (6, 6), self.name), counters)
        width = [int(each) if each.isdecimal() else lengths[each] for each in others]
        if first not in lengths:
            lengths[first] = len(values) // max(math.prod(width), 1)
        count = lengths[first]
        if "T" in others:
            return transforms(values, count, self.name)
        if self._dtype is not None:
            return flat_array(values, (count, *width), self.name, self._dtype)
        if len(values) != count:
            raise Refusal("lengths disagree", f"{self.name}: {len(values)} for {count}")
        return tuple(values)


class Codec:
    """Translates one kind of record into its message, and back.

    ``shapes``: of the fields that are arrays or tuples; the first with a letter sets the length that it stands for.
    """

    def __init__(self, record: type, message_class: Any, **shapes: str) -> None:
        self.message_class = message_class
        self.record = record
        fields = message_class.DESCRIPTOR.fields_by_name
        names = [*shapes, *(f.name for f in dataclasses.fields(record) if f.name not in shapes)]
        self.fields = [_Field(name, fields[_MESSAGE_FIELDS.get(name, name)], shapes.get(name, "")) for name in names]

    def encode(self, record: Any) -> Message:
        """The message of ``record``."""
        values = ((field, getattr(record, field.name)) for field in self.fields)
        message: Message = self.message_class(
            **{field.message_name: field.encode(value) for field, value in values if value is not None}
        )
        return message

    def decode(self, message: Any, counters: Counter[str]) -> Any:
        """The record of ``message``, whose numbers may be any; ``counters`` counts covariances that are left out.

        Raises:
            Refusal: lengths that disagree, or a matrix that is no rotation.
        """
        values = {}
        lengths = {"T": 12}  # numbers of a transform
        for field in self.fields:
            value = getattr(message, field.message_name)
            if field.is_map:  # its order is arbitrary; sorted, a record is the same in every run
                values[field.name] = dict(sorted(value.items()))
            elif field.lengths:
                if len(value) or not field.may_be_empty:
                    values[field.name] = field.decode(value, lengths, counters)
            elif not field.is_optional or message.HasField(field.message_name):
                values[field.name] = value
        return self.record(**values)


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
        Codec(m.ObjectDetections, pb.ObjectDetections, labels="N", positions="N 3", scores="N", covariances="N 3 3?"),
        Codec(m.DetectionTruth, pb.DetectionTruth, object_ids="N"),
        Codec(m.DetectionAssociations, pb.DetectionAssociations, landmark_ids="N", created="N"),
        Codec(
            m.ObjectMapRecord,
            pb.ObjectMap,
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
        Codec(m.TrajectoryRecord, pb.Trajectory, stamps_ns="N", T_map_body="N T"),
        Codec(
            m.FactorGraphRecord,
            pb.FactorGraph,
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
        Codec(m.LoopClosureRecord, pb.LoopClosure, T_reference_query="T?", covariance="6 6?"),
        Codec(m.StatusRecord, pb.Status),
        Codec(m.LocalizationRecord, pb.Localization, sources="S", innovation_ratios="S", covariance="6 6?"),
    )
}


def take_rows(record: _Record, **rows: NDArray[np.int64]) -> _Record:
    """The record with only some rows (K,) of all that has the length with that letter, as ``CODECS`` names it."""
    taken: dict[str, Any] = {}
    for field in CODECS[type(record)].fields:
        letter, *_ = field.lengths or ("",)
        values = getattr(record, field.name)
        if letter in rows and values is not None and len(values):
            kept, is_text = rows[letter], isinstance(values, tuple)
            taken[field.name] = tuple(values[row] for row in kept.tolist()) if is_text else values[kept]
    return dataclasses.replace(record, **taken)
