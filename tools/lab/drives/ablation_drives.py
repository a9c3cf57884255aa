"""Drives that an ablation maps: simulated towns and cities, KITTI 00 and recorded robots, each as one log."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from pathlib import Path

import numpy as np

from logs.importers.imported_log import write_imported_log
from logs.importers.kitti_objects import read_kitti_objects
from slam.simulation.config import load_simulation_config
from slam.simulation.simulation import write_simulation
from slam.simulation.street_grid import generate_street_grid
from slam.simulation.world import load_world
from tools.lab.drives.robot_drives import find_drives, import_drive
from tools.lab.relocalization.kidnaps import thin_world

SEED = 1
"""Of the simulated worlds and drives."""


def _write_town(log: Path, data: Path, *overrides: str) -> None:
    world = generate_street_grid(rng=np.random.default_rng(SEED))
    write_simulation(log, world, load_simulation_config(overrides=overrides), seed=SEED)


def _write_city(log: Path, data: Path, *, city: str, thinned: float) -> None:
    folder = data / "cities" / city
    world = load_world(folder / "objects.csv", folder / "trajectory.csv")
    world = thin_world(world, thinned, rng=np.random.default_rng(SEED))
    write_simulation(log, world, load_simulation_config(), seed=SEED)


def _write_kitti(log: Path, data: Path) -> None:
    folder = data / "kitti00"
    drive = read_kitti_objects(
        detections=folder / "gosmatch_00.tar.xz",
        odometry=folder / "KITTI_00_SPTAM.txt",
        calib=folder / "calib.txt",
        times=folder / "KITTI_00_gt_times.txt",
        ground_truth=folder / "KITTI_00_gt.txt",
    )
    write_imported_log(log, drive.records(), drive.source)


def _write_robot(log: Path, data: Path, *, name: str) -> None:
    (drive,) = find_drives(data / "robots", [name])
    import_drive(drive, log)


ROBOTS = ("evo", "wild03", "lost_in_the_woods", "mrclam6/robot1", "tags", "cones")
DRIVES: dict[str, Callable[[Path, Path], None]] = {
    "demo": _write_town,
    "kitti00": _write_kitti,
    "villeurbanne": partial(_write_city, city="villeurbanne", thinned=1.0),
    "villeurbanne, a tenth": partial(_write_city, city="villeurbanne", thinned=10.0),
    **{name: partial(_write_robot, name=name) for name in ROBOTS},
    "kidnapped": lambda log, data: _write_town(log, data, "kidnap.from_m=900", "kidnap.to_m=300"),
    "kidnapped silently": lambda log, data: _write_town(
        log, data, "kidnap.from_m=900", "kidnap.to_m=300", "kidnap.silent=true"
    ),
}
"""Functions that write the log of a drive (first path) from a folder of data (second path)."""
