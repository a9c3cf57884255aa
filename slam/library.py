"""What other programs call, beside :func:`slam.replay.replay`: results of a log as arrays."""

from __future__ import annotations

import os
from collections.abc import Mapping
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from logs.messages import ObjectMapRecord, Record, TrajectoryRecord
from logs.reader import LogReader
from logs.selection import Selection
from logs.topics import RecordKind
from slam.common.calibration import Calibration
from slam.common.config import Config
from slam.common.errors import InputDataError
from slam.evaluation.evaluate import evaluate
from slam.evaluation.inputs.records import read_records
from slam.evaluation.result import Evaluation
from slam.object_map.map_io import OBJECTS_TOPIC, confirmed
from slam.prepared_log import calibrate_logs

_FINAL_MAP, _FINAL_TRAJECTORY = "/slam/map", "/slam/trajectory_stamped"


def read_map(path: str | os.PathLike[str]) -> ObjectMapRecord:
    """The confirmed landmarks of a log that ``replay`` wrote, or of a saved map.

    Raises:
        LogError: the file cannot be read.
        InputDataError: it holds no map.
    """
    found = _last_record(path, Selection.of(dict.fromkeys((_FINAL_MAP, OBJECTS_TOPIC), RecordKind.OBJECT_MAP)))
    if not isinstance(found, ObjectMapRecord):
        raise InputDataError(f"{path} holds no map ({_FINAL_MAP} or {OBJECTS_TOPIC}); give a log that replay() wrote")
    return confirmed(found)


def read_trajectory(path: str | os.PathLike[str]) -> TrajectoryRecord:
    """The optimised trajectory of a log that ``replay`` wrote: ``stamps_ns`` (N,), ``T_map_body`` (N, 4, 4).

    Raises:
        LogError: the file cannot be read.
        InputDataError: it holds no trajectory.
    """
    found = _last_record(path, Selection.of({_FINAL_TRAJECTORY: RecordKind.TRAJECTORY}))
    if not isinstance(found, TrajectoryRecord):
        raise InputDataError(f"{path} holds no trajectory ({_FINAL_TRAJECTORY}); give a log that replay() wrote")
    return found


def landmark_table(objects: ObjectMapRecord) -> dict[str, NDArray[np.generic]]:
    """Landmarks as named columns of equal length (M,), for example for ``pandas.DataFrame``.

    ``id``; ``label``, the likeliest class, and its ``label_probability``; ``x_m``, ``y_m``, ``z_m`` in the map frame
    and their standard deviations ``x_sigma_m``, ``y_sigma_m``, ``z_sigma_m``; ``state``; ``observations``;
    ``first_seen_ns``, ``last_seen_ns``.
    """
    sigmas = np.sqrt(np.diagonal(objects.covariances, axis1=1, axis2=2))
    columns: dict[str, NDArray[np.generic]] = {
        "id": np.array(objects.ids, dtype=np.str_),
        "label": np.array(objects.labels, dtype=np.str_),
        "label_probability": objects.class_probabilities.max(axis=1, initial=0.0),
    }
    for axis, name in enumerate("xyz"):
        columns[f"{name}_m"] = objects.positions[:, axis]
    for axis, name in enumerate("xyz"):
        columns[f"{name}_sigma_m"] = sigmas[:, axis]
    return columns | {
        "state": np.array(objects.states, dtype=np.str_),
        "observations": objects.observation_counts,
        "first_seen_ns": objects.first_seen_ns,
        "last_seen_ns": objects.last_seen_ns,
    }


def calibrate(
    *logs: str | os.PathLike[str], config: Config | None = None, topics: Mapping[str, str] | None = None
) -> Calibration:
    """The calibration of a robot's sensors from all of its logs together, for ``Slam`` and in ``config.calibration``.

    Args:
        logs: paths, one at least.
        config: values of its calibration that were given are kept.
        topics: kind -> topic, where a log leaves a choice.

    Raises:
        LogError: a log cannot be read, or lacks a topic.
        SlamError: the transforms of a log contradict one another.
    """
    found = calibrate_logs([Path(log) for log in logs], config or Config(), topics=topics)
    return found.config.calibration


def evaluate_log(
    path: str | os.PathLike[str],
    *,
    reference: str | os.PathLike[str] | None = None,
    topics: Mapping[str, str] | None = None,
) -> Evaluation:
    """Compare a log that ``replay`` wrote with the truth; ``to_json_dict()`` of the result holds every figure.

    Args:
        path: the log.
        reference: a log with the truth, where it is not in ``path`` itself.
        topics: kind -> topic, where the log leaves a choice.

    Raises:
        LogError: a file cannot be read.
        EvaluationError: there is nothing to compare.
    """
    return evaluate(read_records(path, reference=reference, topics=topics))


def _last_record(path: str | os.PathLike[str], selection: Selection) -> Record | None:
    with LogReader(path) as reader:
        found = None
        for entry in reader.records(selection):
            found = entry.record
        return found
