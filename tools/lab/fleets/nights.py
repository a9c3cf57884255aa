"""A fleet that grows night by night, with runs that are killed, beside the same fleet mapped at once."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
import time
from collections.abc import Callable, Collection, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import numpy as np

from slam.common.config import Config
from slam.common.errors import FleetError
from slam.fleet.fleet import map_fleet, session_maps
from slam.fleet.tasks import compute_in_processes
from slam.object_map.map_io import load_map
from slam.simulation.street_grid import generate_street_grid
from tools.lab.fleets.score import FleetScore, score_fleet
from tools.lab.fleets.simulated_fleet import FleetPlan, SimulatedFleet, simulate_fleet

_CLI = f"{__name__.removesuffix('lab.fleets.nights')}cli"


@dataclass(frozen=True, slots=True)
class Night:
    """A night of ``logs``: processor time [s] of its last run and the memory [MB] of the largest of its processes."""

    logs: int
    processor_s: float
    memory_mb: float
    was_killed: bool


@dataclass(frozen=True, slots=True)
class GrownFleet:
    """``nights``, and how right the map is after the last one, and if all logs are mapped ``at_once``."""

    nights: tuple[Night, ...]
    night_by_night: FleetScore
    at_once: FleetScore


def benchmark_nights(
    folder: Path,
    plan: FleetPlan,
    nights: int,
    *,
    killed: Collection[int],
    seed: int = 0,
    progress: Callable[[float, str], None] = lambda done, doing: None,
) -> GrownFleet:
    """Simulate a fleet in the generated town and map it twice: by ``dslam fleet add`` each night, and at once.

    Sessions do not depend on the night, byte by byte, so the second fleet takes those of the first.

    Args:
        folder: takes the logs and both fleets.
        plan: how many drives, and what changes.
        nights: over which the drives are spread.
        killed: nights, counted from 1, whose run is killed after a log is mapped, and then started again.
        seed: of the simulation.
        progress: called with the fraction done and what is being done.

    Raises:
        FleetError: a night fails.
    """
    (folder / "logs").mkdir(parents=True, exist_ok=True)
    world = generate_street_grid(rng=np.random.default_rng(1))
    truth = simulate_fleet(folder / "logs", [world], plan, seed=seed)
    grown, done = folder / "nights", list[Night]()
    for number, logs in enumerate(np.array_split(np.arange(len(truth.logs)), nights), start=1):
        progress((number - 1) / nights, f"night {number} of {nights}")
        done.append(_add_night(grown, [truth.logs[row].path for row in logs.tolist()], is_killed=number in killed))
    shutil.copytree(grown / "sessions", folder / "at_once" / "sessions", dirs_exist_ok=True)
    return GrownFleet(tuple(done), _score(truth, grown), _score(truth, folder / "at_once"))


def _add_night(folder: Path, logs: Sequence[Path], *, is_killed: bool) -> Night:
    command = [sys.executable, "-m", _CLI, "fleet", "add", str(folder), *map(str, logs), "--workers", "1"]
    if is_killed:
        before = len(list(folder.glob("sessions/*/session.json")))
        process = subprocess.Popen(command, stderr=subprocess.DEVNULL, stdout=subprocess.DEVNULL)
        while process.poll() is None and len(list(folder.glob("sessions/*/session.json"))) <= before:
            time.sleep(0.05)
        process.kill()
        process.wait()
    process = subprocess.Popen(command, stderr=subprocess.DEVNULL, stdout=subprocess.DEVNULL)
    _, status, used = os.wait4(process.pid, 0)
    if os.waitstatus_to_exitcode(status) > 1:  # 1: a damaged log could not be mapped
        raise FleetError(f"'{' '.join(command)}' failed; run it to see why")
    return Night(len(logs), used.ru_utime + used.ru_stime, used.ru_maxrss * 1024 / 1e6, is_killed)


def _score(truth: SimulatedFleet, folder: Path) -> FleetScore:
    """Score the fleet in a folder; what is mapped and joined there is not done again."""
    fleet = map_fleet(truth.logs, folder, Config(), partial(compute_in_processes, workers=1))
    return score_fleet(truth, fleet, [load_map(path) for path in session_maps(fleet, folder, Config())])
