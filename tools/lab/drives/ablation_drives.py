"""Drives that an ablation maps: simulated towns and cities, KITTI 00 and recorded robots, each as one log."""

from __future__ import annotations

import shutil
from collections.abc import Callable
from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np

from logs.importers.imported_log import write_imported_log
from logs.importers.kitti_objects import read_kitti_objects
from slam.simulation.config import load_simulation_config
from slam.simulation.simulation import write_simulation
from slam.simulation.street_grid import generate_street_grid
from slam.simulation.world import World, load_world
from tools.lab.drives.robot_drives import find_drives, import_drive

SEED = 1
"""Of the simulated worlds and drives."""


def _write_town(log: Path, data: Path, *overrides: str) -> None:
    world = generate_street_grid(rng=np.random.default_rng(SEED))
    write_simulation(log, world, load_simulation_config(overrides=overrides), seed=SEED)


def _write_city(log: Path, data: Path, *, city: str, every: int) -> None:
    """A drive among every so many objects of a city."""
    folder = data / "cities" / city
    world = load_world(folder / "objects.csv", folder / "trajectory.csv")
    world = replace(
        world,
        object_ids=world.object_ids[::every],
        positions=world.positions[::every],
        labels=world.labels[::every],
    )
    write_simulation(log, world, load_simulation_config(), seed=SEED)


def _write_greenhouse(log: Path, data: Path) -> None:
    """A slow robot that sees 5 m, twice through all lanes between rows of plants."""
    rng = np.random.default_rng(SEED)
    rows = [(x, 2.0 * row) for row in range(9) for x in np.arange(0.0, 40.0, 1.5) if rng.random() < 0.9]
    plants = np.pad(np.array(rows) + rng.normal(scale=0.1, size=(len(rows), 2)), ((0, 0), (0, 1)))
    lanes = [[(-2.0, y), (42.0, y)][:: 1 if lane % 2 == 0 else -1] for lane, y in enumerate(np.arange(1.0, 17.0, 2.0))]
    tour = np.array([point for lane in 2 * lanes for point in lane])
    labels = tuple(rng.choice(["tomato", "pepper", "post"], len(plants), p=[0.5, 0.4, 0.1]).tolist())
    world = World("greenhouse", tuple(f"plant {k}" for k in range(len(plants))), plants, labels, tour)
    config = load_simulation_config(
        overrides=(
            "drive.speed_mps=0.8",
            "drive.rate_hz=5",
            "drive.corner_smoothing_m=0.4",
            "odometry.scale_drift_percent=3",
            "odometry.heading_drift_deg_per_100m=8",
            "sensor.max_range_m=5",
            "sensor.noise_base_m=0.03",
            "sensor.covariances=false",
        )
    )
    write_simulation(log, world, config, seed=SEED)


def _write_kitti(log: Path, data: Path) -> None:
    folder = data / "kitti00"
    objects = log.with_suffix("")
    shutil.unpack_archive(folder / "gosmatch_00.tar.xz", objects, filter="data")
    drive = read_kitti_objects(
        detections=objects / "00",
        odometry=folder / "KITTI_00_SPTAM.txt",
        calib=folder / "calib.txt",
        times=folder / "KITTI_00_gt_times.txt",
        ground_truth=folder / "KITTI_00_gt.txt",
    )
    write_imported_log(log, drive.records(), drive.source)
    shutil.rmtree(objects)


def _write_robot(log: Path, data: Path, *, name: str) -> None:
    (drive,) = find_drives(data / "robots", [name])
    import_drive(drive, log)


ROBOTS = ("lost_in_the_woods", "mrclam6/robot1", "mrclam6/robot2", "tags", "cones", "evo", "wild03")
DRIVES: dict[str, Callable[[Path, Path], None]] = {
    "demo": _write_town,
    "greenhouse": _write_greenhouse,
    **{name: partial(_write_robot, name=name) for name in ROBOTS},
    "kidnapped": lambda log, data: _write_town(log, data, "kidnap.from_m=900", "kidnap.to_m=300"),
    "kidnapped silently": lambda log, data: _write_town(
        log, data, "kidnap.from_m=900", "kidnap.to_m=300", "kidnap.silent=true"
    ),
    "villeurbanne, a tenth": partial(_write_city, city="villeurbanne", every=10),
    "villeurbanne": partial(_write_city, city="villeurbanne", every=1),
    "kitti00": _write_kitti,
}
"""Functions that write the log of a drive (first path) from a folder of data (second path), the cheap ones first."""
