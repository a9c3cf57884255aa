"""A simulated fleet, mapped and compared with the truth; and what that costs."""

from __future__ import annotations

import tempfile
import time
from collections import defaultdict
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from slam.common.config import Config
from slam.fleet.fleet import map_fleet, session_maps
from slam.fleet.report import write_report
from slam.fleet.tasks import Compute
from slam.object_map.map_io import load_map
from slam.replay import replay
from slam.simulation.street_grid import generate_street_grid
from slam.simulation.world import load_world
from slam.sweeps.workers import Death
from tools.lab.fleets.score import FleetScore, score_fleet
from tools.lab.fleets.simulated_fleet import FleetPlan, simulate_fleet

SINGLES = 4
"""Logs, evenly from all cities, that are mapped again by a plain replay, to compare the cost."""


@dataclass(frozen=True, slots=True)
class FleetCost:
    """``wall_s`` of the whole; of the processor [s]: ``mapping_s`` and ``finding_s`` of all tasks, ``joining_s`` of the
    driver, ``single_s`` of mapping a log by a plain replay, on average; ``session_mb`` of files a session.
    """

    wall_s: float
    mapping_s: float
    finding_s: float
    joining_s: float
    single_s: float
    session_mb: float


class MeasuredTasks:
    """Adds up the processor time of tasks by the name of their function; an object is a ``Compute`` itself."""

    def __init__(self, compute: Compute) -> None:
        self._compute = compute
        self.seconds: defaultdict[str, float] = defaultdict(float)

    def __call__(self, function: Callable[[Any], Any], tasks: Sequence[Any]) -> Iterator[tuple[Any, Any]]:
        """Each task with its outcome, see :data:`slam.fleet.tasks.Compute`."""
        for (_, task), outcome in self._compute(_measured, [(function, task) for task in tasks]):
            if isinstance(outcome, Death):
                yield task, outcome
                continue
            seconds, result = outcome
            self.seconds[function.__name__] += seconds
            yield task, result


def _measured(call: tuple[Callable[[Any], Any], Any]) -> tuple[float, Any]:
    started = time.process_time()
    result = call[0](call[1])
    return time.process_time() - started, result


def benchmark_fleet(
    folder: Path,
    cities: Sequence[Path],
    plan: FleetPlan,
    compute: Compute,
    *,
    seed: int = 0,
    progress: Callable[[float, str], None] = lambda done, doing: None,
) -> tuple[FleetScore, FleetCost]:
    """Simulate a fleet in the generated town and in cities, map it, and compare it with the truth.

    Args:
        folder: takes the logs and what a fleet leaves.
        cities: folders with objects.csv and trajectory.csv.
        plan: how many drives, and what changes.
        compute: computes tasks.
        seed: of the simulation.
        progress: called with the fraction done and what is being done.

    Raises:
        SimulationError, SlamError, LogError: a city that cannot be used, or a file that cannot be written.
    """
    worlds = [generate_street_grid(rng=np.random.default_rng(1))]
    worlds += [load_world(city / "objects.csv", city / "trajectory.csv") for city in cities]
    (folder / "logs").mkdir(parents=True, exist_ok=True)
    truth = simulate_fleet(folder / "logs", worlds, plan, seed=seed)
    measured = MeasuredTasks(compute)
    started, own = time.perf_counter(), time.process_time()
    fleet = map_fleet(truth.logs, folder, Config(), measured, progress=progress)
    wall_s, own_s = time.perf_counter() - started, time.process_time() - own
    write_report(folder, fleet)
    usable = [log for log in truth.logs if truth.drives[log.name].city >= 0]
    replays = MeasuredTasks(compute)
    replayed = sum(
        not isinstance(outcome, Death)
        for _, outcome in replays(_replay, [log.path for log in usable[:: -(-len(usable) // SINGLES)]])
    )
    maps = [load_map(path) for path in session_maps(fleet, folder, Config())]
    files = [path for path in (folder / "sessions").rglob("*") if path.is_file()]
    cost = FleetCost(
        wall_s=wall_s,
        mapping_s=measured.seconds["map_session"],
        finding_s=measured.seconds["join_session"],
        joining_s=own_s,
        single_s=replays.seconds["_replay"] / max(replayed, 1),
        session_mb=sum(path.stat().st_size for path in files) / 1e6 / max(len(maps), 1),
    )
    return score_fleet(truth, fleet, maps), cost


def _replay(log: Path) -> None:
    with tempfile.TemporaryDirectory() as folder:
        replay(log, Path(folder) / "out.mcap", map_path=Path(folder) / "map.mcap")
