"""What an evaluation says, and the graph it needs, for the tests."""

import json

import numpy as np

from logs.messages import FactorGraphRecord
from slam.common.arrays import FloatArray, IntArray
from slam.evaluation.result import Evaluation


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
