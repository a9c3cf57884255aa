"""What an evaluation says, and the graph it needs, for the tests."""

import json
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np

from logs.messages import DetectionAssociations, DetectionTruth, FactorGraphRecord, Record
from slam.common.arrays import FloatArray, IntArray
from slam.evaluation.evaluate import Evaluation, evaluate
from slam.evaluation.inputs.records import collect_records

Log = list[tuple[str, Record]]
"""Topics and records."""


def associated(frames: tuple[list[DetectionAssociations], list[DetectionTruth]]) -> Log:
    """What a log holds of associations and their truth."""
    associations, truths = frames
    return [
        *(("/slam/associations", record) for record in associations),
        *(("/ground_truth/detections", record) for record in truths),
    ]


def with_field(log: Log, kind: type, field: str, alter: Callable[[Any], object]) -> Log:
    """The log with another value of a field in all records of a kind."""
    return [
        (topic, replace(record, **{field: alter(getattr(record, field))}) if isinstance(record, kind) else record)
        for topic, record in log
    ]


def without(log: Log, topic: str) -> Log:
    """The log but for topics that begin so."""
    return [each for each in log if not each[0].startswith(topic)]


def measured(log: Log) -> Evaluation:
    return evaluate(collect_records(log))


def graph(stamps_ns: IntArray, T_map_body: FloatArray) -> FactorGraphRecord:
    """Keyframes alone."""
    none = np.zeros(0, int)
    return FactorGraphRecord(
        stamp_ns=int(stamps_ns[-1]),
        keyframe_ids=np.arange(len(stamps_ns)),
        keyframe_stamps_ns=stamps_ns,
        T_map_body=T_map_body,
        edge_keyframe_ids=none.reshape(0, 2),
        edge_transforms=np.zeros((0, 4, 4)),
        edge_covariances=np.zeros((0, 6, 6)),
        edge_kinds=(),
        observation_keyframe_ids=none,
        observation_landmark_ids=(),
        observation_positions=np.zeros((0, 3)),
        observation_covariances=np.zeros((0, 3, 3)),
    )


def at_json(evaluation: Evaluation, path: str) -> object:
    value: object = json.loads(json.dumps(evaluation.to_json_dict(), allow_nan=False))
    for key in path.split("."):
        value = value[key]
    return value
