"""A simulated fleet, mapped and compared with the truth; and what that costs."""

from __future__ import annotations

import resource
import time
from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np

from slam.common.config import Config
from slam.fleet.fleet import map_fleet
from slam.fleet.report import write_report
from slam.fleet.sessions import MAP_NAME, session_folder
from slam.object_map.map_io import load_map
from slam.simulation.street_grid import generate_street_grid
from slam.simulation.world import load_world
from tools.lab.fleets.score import score_fleet
from tools.lab.fleets.simulated_fleet import FleetPlan, simulate_fleet


def benchmark_fleet(
    folder: Path,
    cities: Sequence[Path],
    plan: FleetPlan,
    *,
    workers: int,
    seed: int = 0,
    tell: Callable[[str], None] = lambda line: None,
) -> dict[str, float]:
    """Simulate a fleet in the generated town and in cities, map it, and compare it with the truth.

    Returns the figures of :func:`tools.lab.fleets.score.score_fleet`, the seconds of the whole on the clock and of the
    processor, and the files of a session [MB].

    Args:
        folder: takes the logs and what a fleet leaves.
        cities: folders with objects.csv and trajectory.csv.
        plan: how many drives, and what changes.
        workers: logs that are mapped at a time.
        seed: of the simulation.
        tell: called with a line for each log that was mapped.

    Raises:
        SimulationError, SlamError, LogError: a city that cannot be used, or a file that cannot be written.
    """
    worlds = [generate_street_grid(rng=np.random.default_rng(1))]
    worlds += [load_world(city / "objects.csv", city / "trajectory.csv") for city in cities]
    (folder / "logs").mkdir(parents=True, exist_ok=True)
    truth = simulate_fleet(folder / "logs", worlds, plan, seed=seed)
    started, used_s = time.perf_counter(), _processor_s()
    fleet = map_fleet(truth.logs, folder, Config(), workers=workers, tell=tell)
    wall_s, processor_s = time.perf_counter() - started, _processor_s() - used_s
    write_report(folder, fleet)
    maps = [load_map(session_folder(folder, digest, Config()) / MAP_NAME) for digest in fleet.order]
    files = [path for path in (folder / "sessions").rglob("*") if path.is_file()]
    session_mb = sum(path.stat().st_size for path in files) / 1e6 / max(len(maps), 1)
    cost = {"wall_s": wall_s, "processor_s": processor_s, "session_mb": session_mb}
    return score_fleet(truth, fleet, maps) | cost


def _processor_s() -> float:
    """Seconds of the processor of this process and of those that it started and that ended."""
    used = [resource.getrusage(who) for who in (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN)]
    return sum(each.ru_utime + each.ru_stime for each in used)
