"""Functions of the library beside :func:`slam.replay.replay`: maps, and results of a log as arrays."""

from collections.abc import Mapping
from pathlib import Path

from logs.container.limits import RESULT_LIMITS
from logs.messages import ObjectMapRecord, Record, TrajectoryRecord
from logs.reader import LogReader
from logs.selection import Selection
from logs.storage.regular_file import AnyPath
from logs.topics import RecordKind
from slam.common.calibration import Calibration
from slam.common.config import Config
from slam.common.errors import InputDataError
from slam.evaluation.evaluate import Evaluation, evaluate
from slam.evaluation.inputs.records import read_records
from slam.localization.prior_map import PriorMap, load_prior_map
from slam.object_map.map_io import METADATA, OBJECTS_TOPIC, confirmed, write_map
from slam.place_recognition.imported_map import ImportedMap, save_imported_map
from slam.prepared_log import calibrate_logs

_FINAL_MAP, _FINAL_TRAJECTORY = "/slam/map", "/slam/trajectory_stamped"

load_map = load_prior_map
"""A map to localize in or to extend: of a drive (``SavedMap``), or imported or of a fleet (``ImportedMap``)."""


def read_map(path: AnyPath) -> ObjectMapRecord:
    """The confirmed landmarks of a log that ``replay`` wrote, or of a map of any kind: saved, imported or of a fleet.

    Raises:
        LogError: the file cannot be read.
        InputDataError: it holds no map.
        SavedMapError: an imported map that is damaged.
    """
    found = _last_record(path, Selection.of(dict.fromkeys((_FINAL_MAP, OBJECTS_TOPIC), RecordKind.OBJECT_MAP)))
    if isinstance(found, ObjectMapRecord):
        return confirmed(found)
    with LogReader(path) as reader:
        is_map = METADATA in reader.metadata()
    if is_map:
        return load_prior_map(path).objects
    raise InputDataError(f"{path} holds no map ({_FINAL_MAP} or {OBJECTS_TOPIC}); give a log that 'dslam replay' wrote")


def save_map(path: AnyPath, saved: PriorMap) -> None:
    """Write a map that ``load_map`` or ``load_imported_map`` returned, for example with some landmarks left out.

    Raises:
        LogError: it cannot be written.
        SavedMapError: it would be refused when it is loaded.
    """
    if isinstance(saved, ImportedMap):
        save_imported_map(Path(path), saved)
    else:
        write_map(Path(path), saved)


def read_trajectory(path: AnyPath) -> TrajectoryRecord:
    """The optimised trajectory of a log that ``replay`` wrote: ``stamps_ns`` (N,), ``T_map_body`` (N, 4, 4).

    Raises:
        LogError: the file cannot be read.
        InputDataError: it holds no trajectory.
    """
    found = _last_record(path, Selection.of({_FINAL_TRAJECTORY: RecordKind.TRAJECTORY}))
    if not isinstance(found, TrajectoryRecord):
        raise InputDataError(f"{path} holds no trajectory ({_FINAL_TRAJECTORY}); give a log that 'dslam replay' wrote")
    return found


def calibrate(*logs: AnyPath, config: Config | None = None, topics: Mapping[str, str] | None = None) -> Calibration:
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
    path: AnyPath, *, reference: AnyPath | None = None, topics: Mapping[str, str] | None = None
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


def _last_record(path: AnyPath, selection: Selection) -> Record | None:
    with LogReader(path, RESULT_LIMITS) as reader:
        found = None
        for entry in reader.records(selection):
            found = entry.record
        return found
