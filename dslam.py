"""The public library: ``from dslam import replay, read_map, evaluate_log``. These names keep their meaning.

They are looked up when they are first used, so that importing this costs nothing.
"""

from __future__ import annotations

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
    from logs.messages import (
        GroundTruthPose,
        ObjectDetections,
        ObjectMapRecord,
        Odometry,
        TrajectoryRecord,
        Transform,
    )
    from logs.reader import LogReader
    from logs.selection import Selection, select_topics
    from logs.writer import LogWriter
    from slam.common.calibration import Calibration
    from slam.common.config import Config, load_config
    from slam.common.errors import InputDataError, SlamError
    from slam.evaluation.result import Evaluation
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

_NAMES_OF_MODULES = {
    "descriptors.class_vectors": ("class_vectors",),
    "descriptors.constellation": ("Constellations",),
    "descriptors.descriptor": ("Descriptor",),
    "descriptors.errors": ("DescriptorError",),
    "logs.clouds.labelled_cloud": ("LabelledCloud",),
    "logs.clouds.objects": ("find_objects",),
    "logs.errors": ("LogError",),
    "logs.messages": (
        "GroundTruthPose",
        "ObjectDetections",
        "ObjectMapRecord",
        "Odometry",
        "TrajectoryRecord",
        "Transform",
    ),
    "logs.reader": ("LogReader",),
    "logs.selection": ("Selection", "select_topics"),
    "logs.writer": ("LogWriter",),
    "slam.common.calibration": ("Calibration",),
    "slam.common.config": ("Config", "load_config"),
    "slam.common.errors": ("InputDataError", "SlamError"),
    "slam.evaluation.result": ("Evaluation",),
    "slam.formats.landmark_tables": ("landmark_table",),
    "slam.library": ("calibrate", "evaluate_log", "load_map", "read_map", "read_trajectory", "save_map"),
    "slam.localization.prior_map": ("PriorMap",),
    "slam.object_map.map_io": ("SavedMap",),
    "slam.place_recognition.imported_map": ("ImportedMap", "load_imported_map"),
    "slam.place_recognition.initial_pose": ("InitialPose",),
    "slam.replay": ("ReplaySummary", "replay"),
    "slam.scan_localization": ("ScanLocalization", "ScanLocalizer"),
    "slam.final_map": ("FinalMap",),
    "slam.live_slam": ("LiveSlam",),
}
_PLACE_OF = {name: (module, name) for module, names in _NAMES_OF_MODULES.items() for name in names}
# To map a robot needs no calibration beforehand.
_PLACE_OF["Slam"] = _PLACE_OF.pop("LiveSlam")

_IS_INSTALLED = bool(__package__)
"""In a wheel this file is the package ``dslam``, and the folders beside it are its sub-packages; see ``setup.py``."""


def __getattr__(name: str) -> object:
    if name == "__version__":
        return version("descriptellation-slam")
    if name not in _PLACE_OF:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    module, attribute = _PLACE_OF[name]
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
