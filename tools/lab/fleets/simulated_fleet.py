"""A fleet that never drove: robots with noise of their own in cities whose objects come and go from month to month."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from slam.common.arrays import FloatArray
from slam.fleet.logs import FleetLog
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
class Event:
    """An object that comes (``kind`` "appeared") or goes ("gone") at the begin of ``month``."""

    kind: str
    month: int
    object_id: str
    label: str
    position: FloatArray


@dataclass(frozen=True, slots=True, eq=False)
class TrueDrive:
    """``city`` by its number, -1 where the log is of no use; ``T_world_first`` (4, 4); ``path`` (N, 2) m."""

    city: int
    month: int
    T_world_first: FloatArray
    path: FloatArray


@dataclass(frozen=True, slots=True, eq=False)
class SimulatedFleet:
    """``logs`` and the truth of each by name; ``worlds`` by city and month; ``events`` by city."""

    logs: tuple[FleetLog, ...]
    drives: dict[str, TrueDrive]
    worlds: tuple[tuple[World, ...], ...]
    events: tuple[tuple[Event, ...], ...]


def simulate_fleet(folder: Path, cities: Sequence[World], plan: FleetPlan, *, seed: int) -> SimulatedFleet:
    """Write the logs into ``folder``.

    Raises:
        SimulationError: a tour that is too short.
        UnwritableLogError: a log cannot be written.
    """
    rng = np.random.default_rng(seed)
    robots = [_robot(rng) for _ in range(ROBOTS)]
    strange = generate_street_grid(rng=np.random.default_rng(seed + 1000), name="another town")
    logs, drives, worlds, events = list[FleetLog](), dict[str, TrueDrive](), [], []
    for city, world in enumerate(cities):
        driven = world.shortened(plan.area_m)
        versions, of_city = _evolve(driven, plan, rng)
        worlds.append(versions)
        events.append(of_city)
        for number in range(plan.drives):
            month = number * plan.months // plan.drives
            is_bad = int(plan.bad * (len(logs) + 1)) > int(plan.bad * len(logs))
            is_strange = is_bad and number % 2 == 1
            name = f"{world.name}_{number:03d}"
            path = folder / f"{name}.mcap"
            source = strange.shortened(plan.area_m) if is_strange else versions[month]
            part = replace(source, tour=_part(source.tour, plan.length_m, rng))
            robot = robots[int(rng.integers(ROBOTS))]
            config = robot.model_copy(update={"drive": DriveConfig(start_day=month * MONTH_DAYS + number)})
            write_simulation(path, part, config, seed=int(rng.integers(2**31)))
            if is_bad and not is_strange:
                path.write_bytes(path.read_bytes()[: path.stat().st_size // 50])
            logs.append(FleetLog(name, path))
            sampled = plan_drive(part.tour, config.drive)
            first = sampled.sample(0.0, sampled.length_m).T_world_body
            drives[name] = TrueDrive(-1 if is_bad else city, month, first[0], first[:, :2, 3])
    return SimulatedFleet(tuple(logs), drives, tuple(worlds), tuple(events))


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


def _evolve(world: World, plan: FleetPlan, rng: np.random.Generator) -> tuple[tuple[World, ...], tuple[Event, ...]]:
    """The world month by month: of what changes a third goes, a third comes, and a third moves."""
    versions, events = [world], list[Event]()
    for month in range(1, plan.months):
        now = versions[-1]
        count = round(plan.changed * len(now.object_ids) / 3.0)
        chosen = rng.choice(len(now.object_ids), 2 * count, replace=False)
        moves = chosen[count:]
        like = rng.choice(len(now.object_ids), count)
        place = now.tour[rng.integers(len(now.tour), size=count)] + rng.uniform(-STREET_M, STREET_M, (count, 2))
        angle, far_m = rng.uniform(-np.pi, np.pi, count), rng.uniform(*MOVED_M, count)
        moved = now.positions[moves, :2] + far_m[:, None] * np.column_stack([np.cos(angle), np.sin(angle)])
        gone = set(chosen.tolist())
        kept = [row for row in range(len(now.object_ids)) if row not in gone]
        labels = [now.labels[row] for row in (*like.tolist(), *moves.tolist())]
        ids = [f"new-{month}-{number}" for number in range(len(labels))]
        heights = now.positions[np.concatenate([like, moves]), 2]
        positions = np.column_stack([np.vstack([place, moved]), heights])
        events += [
            Event("gone", month, now.object_ids[row], now.labels[row], now.positions[row]) for row in chosen.tolist()
        ]
        events += [Event("appeared", month, *each) for each in zip(ids, labels, positions, strict=True)]
        versions.append(
            replace(
                now,
                object_ids=(*(now.object_ids[row] for row in kept), *ids),
                positions=np.vstack([now.positions[kept], positions]),
                labels=(*(now.labels[row] for row in kept), *labels),
            )
        )
    return tuple(versions), tuple(events)
