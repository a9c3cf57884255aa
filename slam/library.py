"""What other programs call, beside :func:`slam.replay.replay`: results of a log as arrays, and one scan in a map."""

from __future__ import annotations

import os
from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

from descriptors.registry import make_index
from logs.messages import ObjectDetections, ObjectMapRecord, Record, TrajectoryRecord
from logs.reader import LogReader
from logs.selection import Selection
from logs.topics import RecordKind
from slam.common.arrays import FloatArray, IntArray
from slam.common.config import Config
from slam.common.errors import InputDataError
from slam.evaluation.evaluate import evaluate
from slam.evaluation.inputs.records import read_records
from slam.evaluation.result import Evaluation
from slam.object_map.map_io import OBJECTS_TOPIC, confirmed
from slam.place_recognition.global_localization import GlobalLocalizer, LabelledMap
from slam.registration.registration import Registration

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


class ScanLocalizer:
    """Finds single scans in a map, without odometry. Reuse one for many scans: it holds the index of the map."""

    def __init__(self, objects: ObjectMapRecord, config: Config | None = None) -> None:
        """Describe all landmarks of ``objects`` with the descriptor of ``config.loop_closure``.

        Raises:
            InputDataError: the map is empty.
            DescriptorError: there is no such descriptor.
        """
        self._config = Config() if config is None else config
        self._number = {label: number for number, label in enumerate(objects.vocabulary)}
        self._map_sigma_m = _typical_sigma_m(objects)
        known = LabelledMap(objects.positions, self._numbers(objects.labels), objects.vocabulary)
        self._localizer = GlobalLocalizer(known, make_index(self._config.loop_closure.descriptor))

    def localize(self, scan: ObjectDetections) -> Registration:
        """The pose of the scan in the map, ``T_reference_query`` = ``T_map_scan``; None, and the reason, if not found.

        Args:
            scan: detections in a frame whose z points up, such as the body of a robot on level ground. Objects of
                classes that the map does not have are left out.
        """
        known = np.array([label in self._number for label in scan.labels], dtype=np.bool_)
        positions = scan.positions[known]
        submap = self._config.submap
        ranges_m = np.linalg.norm(positions, axis=1)
        return self._localizer.localize(
            positions,
            self._numbers([label for label in scan.labels if label in self._number]),
            self._config.registration,
            query_sigmas=np.hypot(submap.landmark_sigma_m, submap.sigma_per_m * ranges_m),
            map_sigma_m=self._map_sigma_m,
        ).registration

    def _numbers(self, labels: tuple[str, ...] | list[str]) -> IntArray:
        return np.array([self._number[label] for label in labels], dtype=np.int64)


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


def _typical_sigma_m(objects: ObjectMapRecord) -> float:
    """Of a landmark along any axis."""
    if len(objects.ids) == 0:
        raise InputDataError("the map holds no confirmed landmark, so that no scan can be found in it")
    variances: FloatArray = np.trace(objects.covariances, axis1=1, axis2=2) / 3.0
    return float(np.sqrt(np.median(variances)))
