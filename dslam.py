"""The public library: ``from dslam import replay, read_map, evaluate_log``. These names keep their meaning.

They are looked up when they are first used, so that importing this costs nothing.
"""

from __future__ import annotations

import sys
from importlib import import_module
from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from descriptors.constellation import Constellations
    from descriptors.descriptor import Descriptor
    from descriptors.errors import DescriptorError
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
    from slam.library import calibrate, evaluate_log, landmark_table, read_map, read_trajectory
    from slam.live_slam import LiveSlam as Slam
    from slam.object_map.map_io import SavedMap, load_map
    from slam.replay import ReplaySummary, replay
    from slam.scan_localization import ScanLocalization, ScanLocalizer

__all__ = [
    "Calibration",
    "Config",
    "Constellations",
    "Descriptor",
    "DescriptorError",
    "Evaluation",
    "FinalMap",
    "GroundTruthPose",
    "InputDataError",
    "LogError",
    "LogReader",
    "LogWriter",
    "ObjectDetections",
    "ObjectMapRecord",
    "Odometry",
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
    "evaluate_log",
    "landmark_table",
    "load_config",
    "load_map",
    "read_map",
    "read_trajectory",
    "replay",
    "select_topics",
]

_NAMES_OF_MODULES = {
    "descriptors.constellation": ("Constellations",),
    "descriptors.descriptor": ("Descriptor",),
    "descriptors.errors": ("DescriptorError",),
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
    "slam.library": ("calibrate", "evaluate_log", "landmark_table", "read_map", "read_trajectory"),
    "slam.object_map.map_io": ("SavedMap", "load_map"),
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
