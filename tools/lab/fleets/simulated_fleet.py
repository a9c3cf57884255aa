"""A fleet that never drove: robots with noise of their own in cities whose objects come and go from month to month."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import pandas as pd

from slam.common.arrays import FloatArray
from slam.fleet.logs import FleetLog, find_logs
from slam.simulation.config import DriveConfig, OdometryConfig, SensorConfig, SimulationConfig
from slam.simulation.drive import plan_drive
from slam.simulation.simulation import write_simulation
from slam.simulation.street_grid import generate_street_grid
from slam.simulation.world import World

MONTH_DAYS = 30
ROBOTS = 10
MOVED_M = (3.0, 12.0)
STREET_M = 15.0
"""New objects stand so far from the tour at most."""
XYZ = ["x", "y", "z"]


@dataclass(frozen=True, slots=True)
class FleetPlan:
    """``drives`` of ``length_m`` in each city, on the first ``area_m`` of its tour, spread over ``months``; a share
    ``changed`` of the objects changes from one to the next; a share ``bad`` of the logs is damaged or of another town.
    """

    drives: int = 8
    length_m: float = 250.0
    area_m: float = 350.0
    months: int = 4
    changed: float = 0.1
    bad: float = 0.1


@dataclass(frozen=True, slots=True, eq=False)
class TrueDrive:
    """``city`` by its number, -1 where the log is of no use; ``T_world_first`` (4, 4); ``path`` (N, 2) m."""

    city: int
    month: int
    T_world_first: FloatArray
    path: FloatArray


@dataclass(frozen=True, slots=True, eq=False)
class SimulatedFleet:
    """``logs``, and the true drive of each by its digest; ``objects`` of each city, by their ids: ``label``, ``x``,
    ``y``, ``z`` [m], and the months in whose beginning they ``came`` (0: before) and ``went`` (NaN: never).
    """

    logs: tuple[FleetLog, ...]
    drives: dict[str, TrueDrive]
    objects: tuple[pd.DataFrame, ...]


def simulate_fleet(folder: Path, cities: Sequence[World], plan: FleetPlan, *, seed: int) -> SimulatedFleet:
    """Write the logs into ``folder``.

    Raises:
        SimulationError: a tour that is too short.
        UnwritableLogError: a log cannot be written.
    """
    rng = np.random.default_rng(seed)
    robots = [_robot(rng) for _ in range(ROBOTS)]
    strange = generate_street_grid(rng=np.random.default_rng(seed + 1000), name="another town")
    logs, drives, objects = list[FleetLog](), dict[str, TrueDrive](), []
    for city, world in enumerate(cities):
        driven = world.shortened(plan.area_m)
        objects.append(_changing_objects(driven, plan, rng))
        for number in range(plan.drives):
            month = number * plan.months // plan.drives
            is_bad = int(plan.bad * (len(logs) + 1)) > int(plan.bad * len(logs))
            is_strange = is_bad and number % 2 == 1
            source = strange.shortened(plan.area_m) if is_strange else _in_month(driven, objects[city], month)
            part = replace(source, tour=_part(source.tour, plan.length_m, rng))
            drive = DriveConfig(start_day=month * MONTH_DAYS + number)
            config = robots[int(rng.integers(ROBOTS))].model_copy(update={"drive": drive})
            path = folder / f"{world.name}_{number:03d}.mcap"
            write_simulation(path, part, config, seed=int(rng.integers(2**31)))
            if is_bad and not is_strange:
                path.write_bytes(path.read_bytes()[: path.stat().st_size // 50])
            logs += find_logs([str(path)])
            planned = plan_drive(part.tour, drive)
            T_world_body = planned.sample(0.0, planned.length_m).T_world_body
            drives[logs[-1].sha256] = TrueDrive(-1 if is_bad else city, month, T_world_body[0], T_world_body[:, :2, 3])
    return SimulatedFleet(tuple(logs), drives, tuple(objects))


def _robot(rng: np.random.Generator) -> SimulationConfig:
    return SimulationConfig(
        odometry=OdometryConfig(
            scale_drift_percent=float(rng.uniform(0.3, 2.0)), heading_drift_deg_per_100m=float(rng.uniform(0.2, 1.0))
        ),
        sensor=SensorConfig(
            noise_base_m=float(rng.uniform(0.05, 0.2)),
            noise_per_m=float(rng.uniform(0.005, 0.02)),
            dropout=float(rng.uniform(0.05, 0.3)),
            false_positives_per_scan=float(rng.uniform(0.1, 1.0)),
            misclassification=float(rng.uniform(0.02, 0.15)),
        ),
    )


def _part(tour: FloatArray, length_m: float, rng: np.random.Generator) -> FloatArray:
    """A stretch of the tour, in either direction."""
    along = np.append(0.0, np.cumsum(np.linalg.norm(np.diff(tour, axis=0), axis=1)))
    begin = rng.uniform(0.0, max(along[-1] - length_m, 0.0))
    at = np.arange(begin, min(begin + length_m, along[-1]), 1.0)
    part = np.column_stack([np.interp(at, along, tour[:, axis]) for axis in (0, 1)])
    return part[::-1] if rng.random() < 0.5 else part


def _changing_objects(world: World, plan: FleetPlan, rng: np.random.Generator) -> pd.DataFrame:
    """All objects that ever stand in a world: of what changes in a month a third goes, a third comes, a third moves."""
    objects = pd.DataFrame(world.positions, columns=XYZ, index=world.object_ids)
    objects = objects.assign(label=world.labels, came=0, went=np.nan)
    for month in range(1, plan.months):
        present = objects.index[objects["went"].isna()]
        count = round(plan.changed * len(present) / 3.0)
        leaving = rng.choice(present, 2 * count, replace=False)
        new = objects.loc[rng.choice(present, count)]
        beside = world.tour[rng.integers(len(world.tour), size=count)] + rng.uniform(-STREET_M, STREET_M, (count, 2))
        new = new.assign(x=beside[:, 0], y=beside[:, 1])
        moved = objects.loc[leaving[count:]]
        angle, far_m = rng.uniform(-np.pi, np.pi, count), rng.uniform(*MOVED_M, count)
        moved = moved.assign(x=moved["x"] + far_m * np.cos(angle), y=moved["y"] + far_m * np.sin(angle))
        coming = pd.concat([new, moved]).assign(came=month)
        objects.loc[leaving, "went"] = month
        objects = pd.concat([objects, coming.set_axis([f"new-{month}-{number}" for number in range(2 * count)])])
    return objects


def _in_month(world: World, objects: pd.DataFrame, month: int) -> World:
    now = objects[(objects["came"] <= month) & ~(objects["went"] <= month)]
    return replace(world, object_ids=tuple(now.index), positions=now[XYZ].to_numpy(), labels=tuple(now["label"]))
