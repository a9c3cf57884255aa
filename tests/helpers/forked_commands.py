"""Commands that are run in many forks of one process, in which all that they need is imported already."""

from __future__ import annotations

import contextlib
from pathlib import Path

from tools.cli import make_app

SCRATCH = "/dev/shm" if Path("/dev/shm").is_dir() else None
"""Where files are made: outputs are flushed to the disk before they get their names, which takes longer than the rest
of most commands."""
_IMPORTED = ("slam.replay", "slam.evaluation.evaluate", "logs.summary",
             "slam.display.map_picture", "rich.table",
             "matplotlib.pyplot", "slam.object_map.map_io", "tools.console",
             "descriptors.learned.descriptor",
             "descriptors.training.contrast", "slam.simulation.faults.registry",
             "slam.simulation.faults.faulty_log", "logs.importers.text_log", "logs.importers.detection_tables",
             "osmium",
             "logs.importers.maps.osm", "slam.fleet.joint_map", "slam.sweeps.comparison",
             "slam.sweeps.sweep",
             "tools.evaluation.evaluate", "logs.clouds.map_of_cloud",
             "multiprocessing.pool", "encodings.idna", "_strptime")  # fmt: skip


def import_commands() -> None:
    """Import what the commands import when they are called, as far as it is installed."""
    for module in _IMPORTED:
        with contextlib.suppress(ImportError, OSError):
            __import__(module)
    make_app()
