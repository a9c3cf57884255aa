"""How fast a replay is and how much memory it takes."""

from __future__ import annotations

import multiprocessing
import resource
import statistics
import sys
from collections.abc import Iterator
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory

from slam.config import Config


@dataclass(frozen=True, slots=True)
class ReplayRun:
    """One replay in a process of its own; ``solver_s`` is the time inside GTSAM."""

    log_s: float
    wall_s: float
    solver_s: float
    longest_stall_s: float
    peak_memory_bytes: int


@dataclass(frozen=True, slots=True)
class ReplayBenchmark:
    """Medians over ``runs`` of one log, and the range of the times; shares are of the wall time."""

    log: str
    log_s: float
    runs: int
    wall_s: float
    wall_min_s: float
    wall_max_s: float
    x_real_time: float
    solver_share: float
    own_share: float
    longest_stall_s: float
    peak_memory_bytes: int


def benchmark_replay(log: Path, config: Config, *, runs: int) -> ReplayBenchmark:
    """Replay ``log`` ``runs`` times, each in a fresh process, into a temporary folder."""
    measured = list(_runs(log, config, runs))
    wall_s = statistics.median(run.wall_s for run in measured)
    solver_share = statistics.median(run.solver_s / run.wall_s for run in measured)
    return ReplayBenchmark(
        log=str(log),
        log_s=measured[0].log_s,
        runs=runs,
        wall_s=wall_s,
        wall_min_s=min(run.wall_s for run in measured),
        wall_max_s=max(run.wall_s for run in measured),
        x_real_time=measured[0].log_s / wall_s,
        solver_share=solver_share,
        own_share=1.0 - solver_share,
        longest_stall_s=statistics.median(run.longest_stall_s for run in measured),
        peak_memory_bytes=max(run.peak_memory_bytes for run in measured),
    )


def _runs(log: Path, config: Config, runs: int) -> Iterator[ReplayRun]:
    context = multiprocessing.get_context("spawn")
    for _ in range(runs):
        with ProcessPoolExecutor(1, mp_context=context) as pool:
            yield pool.submit(_measure, log, config).result()


def _measure(log: Path, config: Config) -> ReplayRun:
    from slam.replay import replay

    with TemporaryDirectory() as folder:
        summary = replay(log, Path(folder) / "output.mcap", config)
    return ReplayRun(summary.log_s, summary.wall_s, summary.solver_s, summary.longest_stall_s, _peak_memory_bytes())


def _peak_memory_bytes() -> int:
    """Most memory that this process held. Linux's rusage would count what the parent held when it was started."""
    try:
        status = Path("/proc/self/status").read_text(encoding="ascii")
    except OSError:
        peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
        return peak if sys.platform == "darwin" else peak * 1024
    line = next(line for line in status.splitlines() if line.startswith("VmHWM:"))
    return int(line.split()[1]) * 1024
