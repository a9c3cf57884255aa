"""How fast a replay is and how much memory it takes."""

from __future__ import annotations

import multiprocessing
import resource
import signal
import statistics
import sys
from dataclasses import dataclass
from multiprocessing.connection import Connection
from pathlib import Path
from tempfile import TemporaryDirectory

from logs.errors import LogError
from slam.common.config import Config
from slam.common.errors import SlamError


@dataclass(frozen=True, slots=True)
class ReplayRun:
    """One replay in a process of its own; ``solver_s`` is the time inside GTSAM, ``loop_closure_median_s``
    what looking for loops takes at a keyframe.
    """

    log_s: float
    wall_s: float
    solver_s: float
    max_message_latency_s: float
    loop_closure_median_s: float
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
    real_time_factor: float
    solver_share: float
    own_share: float
    max_message_latency_s: float
    loop_closure_median_s: float
    peak_memory_bytes: int


def benchmark_replay(log: Path, config: Config, *, runs: int) -> ReplayBenchmark:
    """Replay ``log`` ``runs`` times, each in a fresh process, into a temporary folder."""
    with TemporaryDirectory() as folder:
        measured = [measure_replay(log, Path(folder) / "output.mcap", config) for _ in range(runs)]
    wall_s = statistics.median(run.wall_s for run in measured)
    solver_share = statistics.median(run.solver_s / run.wall_s for run in measured)
    return ReplayBenchmark(
        log=str(log),
        log_s=measured[0].log_s,
        runs=runs,
        wall_s=wall_s,
        wall_min_s=min(run.wall_s for run in measured),
        wall_max_s=max(run.wall_s for run in measured),
        real_time_factor=measured[0].log_s / wall_s,
        solver_share=solver_share,
        own_share=1.0 - solver_share,
        max_message_latency_s=statistics.median(run.max_message_latency_s for run in measured),
        loop_closure_median_s=statistics.median(run.loop_closure_median_s for run in measured),
        peak_memory_bytes=max(run.peak_memory_bytes for run in measured),
    )


def measure_replay(log: Path, output: Path, config: Config) -> ReplayRun:
    """Replay ``log`` into ``output`` in a process of its own.

    Raises:
        LogError: the log cannot be read, or the output cannot be written.
        SlamError: the log cannot be mapped, or the process ended without a result.
    """
    context = multiprocessing.get_context("spawn")
    receiver, sender = context.Pipe(duplex=False)
    process = context.Process(target=_measure, args=(sender, log, output, config), daemon=True)
    process.start()
    sender.close()
    try:
        outcome = receiver.recv()
    except EOFError as error:
        process.join()
        raise SlamError(
            f"the replay of {log} ended without a result (exit code {process.exitcode}); was the memory enough?"
        ) from error
    finally:
        process.terminate()
        process.join()
    if not isinstance(outcome, ReplayRun):
        raise outcome
    return outcome


def _measure(sender: Connection, log: Path, output: Path, config: Config) -> None:
    """Replay, and send a ReplayRun or the error."""
    from slam.replay import replay

    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C is for the parent, which ends this process
    try:
        done = replay(log, output, config)
    except (LogError, SlamError) as error:
        sender.send(error)
    else:
        times = (done.log_s, done.wall_s, done.solver_s, done.max_message_latency_s, done.loop_closure_median_s)
        sender.send(ReplayRun(*times, _peak_memory_bytes()))


def _peak_memory_bytes() -> int:
    """Most memory that this process held. Linux's rusage would count what the parent held when it was started."""
    try:
        status = Path("/proc/self/status").read_text(encoding="ascii")
    except OSError:
        peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
        return peak if sys.platform == "darwin" else peak * 1024
    line = next(line for line in status.splitlines() if line.startswith("VmHWM:"))
    return int(line.split()[1]) * 1024
