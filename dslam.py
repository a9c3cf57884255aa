"""The public library: ``from dslam import replay, read_map, evaluate_log``. These names keep their meaning.

They are looked up when they are first used, so that importing this costs nothing.
"""

import sys
from importlib import import_module
from importlib.metadata import version
from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from descriptors.class_vectors import class_vectors
    from descriptors.constellation import Constellations
    from descriptors.descriptor import Descriptor
    from descriptors.errors import DescriptorError
    from logs.clouds.labelled_cloud import LabelledCloud
    from logs.clouds.objects import find_objects
    from logs.errors import LogError
    from logs.messages import GroundTruthPose, ObjectDetections, ObjectMapRecord, Odometry, TrajectoryRecord, Transform
    from logs.reader import LogReader
    from logs.selection import Selection, select_topics
    from logs.writer import LogWriter
    from slam.common.calibration import Calibration
    from slam.common.config import Config, load_config
    from slam.common.errors import InputDataError, SlamError
    from slam.evaluation.evaluate import Evaluation
    from slam.final_map import FinalMap
    from slam.formats.landmark_tables import landmark_table
    from slam.library import calibrate, evaluate_log, load_map, read_map, read_trajectory, save_map
    from slam.live_slam import LiveSlam as Slam
    from slam.localization.prior_map import PriorMap
    from slam.object_map.map_io import SavedMap
    from slam.place_recognition.imported_map import ImportedMap, load_imported_map
    from slam.place_recognition.initial_pose import InitialPose
    from slam.replay import ReplaySummary, replay
    from slam.scan_localization import ScanLocalization, ScanLocalizer

    __version__: str

__all__ = [
    "Calibration",
    "Config",
    "Constellations",
    "Descriptor",
    "DescriptorError",
    "Evaluation",
    "FinalMap",
    "GroundTruthPose",
    "ImportedMap",
    "InitialPose",
    "InputDataError",
    "LabelledCloud",
    "LogError",
    "LogReader",
    "LogWriter",
    "ObjectDetections",
    "ObjectMapRecord",
    "Odometry",
    "PriorMap",
    "ReplaySummary",
    "SavedMap",
    "ScanLocalization",
    "ScanLocalizer",
    "Selection",
    "Slam",
    "SlamError",
    "TrajectoryRecord",
    "Transform",
    "calibrate",
    "class_vectors",
    "evaluate_log",
    "find_objects",
    "landmark_table",
    "load_config",
    "load_imported_map",
    "load_map",
    "read_map",
    "read_trajectory",
    "replay",
    "save_map",
    "select_topics",
]

_MODULE_OF = {
    "Calibration": "slam.common.calibration",
    "Config": "slam.common.config",
    "Constellations": "descriptors.constellation",
    "Descriptor": "descriptors.descriptor",
    "DescriptorError": "descriptors.errors",
    "Evaluation": "slam.evaluation.evaluate",
    "FinalMap": "slam.final_map",
    "GroundTruthPose": "logs.messages",
    "ImportedMap": "slam.place_recognition.imported_map",
    "InitialPose": "slam.place_recognition.initial_pose",
    "InputDataError": "slam.common.errors",
    "LabelledCloud": "logs.clouds.labelled_cloud",
    "LogError": "logs.errors",
    "LogReader": "logs.reader",
    "LogWriter": "logs.writer",
    "ObjectDetections": "logs.messages",
    "ObjectMapRecord": "logs.messages",
    "Odometry": "logs.messages",
    "PriorMap": "slam.localization.prior_map",
    "ReplaySummary": "slam.replay",
    "SavedMap": "slam.object_map.map_io",
    "ScanLocalization": "slam.scan_localization",
    "ScanLocalizer": "slam.scan_localization",
    "Selection": "logs.selection",
    "Slam": "slam.live_slam",
    "SlamError": "slam.common.errors",
    "TrajectoryRecord": "logs.messages",
    "Transform": "logs.messages",
    "calibrate": "slam.library",
    "class_vectors": "descriptors.class_vectors",
    "evaluate_log": "slam.library",
    "find_objects": "logs.clouds.objects",
    "landmark_table": "slam.formats.landmark_tables",
    "load_config": "slam.common.config",
    "load_imported_map": "slam.place_recognition.imported_map",
    "load_map": "slam.library",
    "read_map": "slam.library",
    "read_trajectory": "slam.library",
    "replay": "slam.replay",
    "save_map": "slam.library",
    "select_topics": "logs.selection",
}

_IS_INSTALLED = bool(__package__)
"""In a wheel this file is the package ``dslam``, and the folders beside it are its sub-packages; see ``setup.py``."""


def __getattr__(name: str) -> object:
    if name == "__version__":
        return version("descriptellation-slam")
    if name not in _MODULE_OF:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    module = _MODULE_OF[name]
    # To map a robot needs no calibration beforehand.
    attribute = "LiveSlam" if name == "Slam" else name
    return getattr(import_module(f"dslam.{module}" if _IS_INSTALLED else module), attribute)


def __dir__() -> list[str]:
    return __all__


def main() -> None:
    """Entry point of the command ``dslam``."""
    if not _IS_INSTALLED:  # this checkout comes before packages called slam, logs or tools elsewhere on the path
        sys.path.insert(0, str(Path(__file__).resolve().parent))
    from tools import main as run

    run()


if __name__ == "__main__":
    main()
