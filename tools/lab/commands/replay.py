"""dslam benchmark replay."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from statistics import median
from typing import TYPE_CHECKING, Annotated

import typer

from tools.arguments import ConfigFile, Json, Settings
from tools.lab.tables import number, percent, report

if TYPE_CHECKING:
    from slam.common.config import Config


def replay(
    logs: Annotated[
        list[Path] | None,
        typer.Argument(metavar="[LOG.mcap]...", help="Logs to replay; without any a simulated drive."),
    ] = None,
    config_file: ConfigFile = None,
    settings: Settings = None,
    runs: Annotated[int, typer.Option(min=1, help="Runs of each log, each in a fresh process.")] = 1,
    json: Json = False,
) -> None:
    """Replay logs and measure time, the share of it inside GTSAM, the largest latency and the memory.

    Example: dslam benchmark replay drive.mcap --runs 5
    """
    from slam.common.config import load_config

    config = load_config(config_file, settings or ())
    with _logs(logs or []) as paths:
        results = [_measure(path, config, runs) for path in paths]
    report([_row(each) for each in results], json={"logs": results} if json else None)


def _measure(log: Path, config: Config, runs: int) -> dict[str, float | str]:
    """Medians over the runs of a log, and the range of the times; shares are of the wall time.

    Raises:
        SlamError: the log cannot be mapped.
    """
    from tempfile import TemporaryDirectory

    from slam.common.errors import SlamError
    from slam.sweeps.mapped_drive import DriveTask, map_drives

    with TemporaryDirectory() as folder:
        task = DriveTask(str(log), log, config, Path(folder), is_evaluated=False)
        done = list(map_drives([task] * runs))
    summaries = [run.summary for run in done if run.summary is not None]
    if len(summaries) < runs:
        raise SlamError(next(run.error for run in done if run.error))
    walls_s = [each.wall_s for each in summaries]
    solver_share = median(each.solver_s / each.wall_s for each in summaries)
    return {
        "log": str(log),
        "log_s": summaries[0].log_s,
        "runs": runs,
        "wall_s": median(walls_s),
        "wall_min_s": min(walls_s),
        "wall_max_s": max(walls_s),
        "real_time_factor": summaries[0].log_s / median(walls_s),
        "solver_share": solver_share,
        "own_share": 1.0 - solver_share,
        "max_message_latency_s": median(each.max_message_latency_s for each in summaries),
        "loop_closure_median_s": median(each.loop_closure_median_s for each in summaries),
        "peak_memory_bytes": max(run.peak_memory_bytes for run in done),
    }


def _row(result: dict[str, float | str]) -> dict[str, str]:
    r = {name: value for name, value in result.items() if not isinstance(value, str)}
    spread = "" if r["runs"] == 1 else f" ({r['wall_min_s']:.2f}-{r['wall_max_s']:.2f})"
    return {
        "log": Path(str(result["log"])).name,
        "log s": number(r["log_s"], 0),
        "wall s": f"{r['wall_s']:.2f}{spread}",
        "x real time": number(r["real_time_factor"], 1),
        "GTSAM %": percent(r["solver_share"], 0),
        "own %": percent(r["own_share"], 0),
        "stall ms": number(r["max_message_latency_s"], 0, 1e3),
        "closing ms": number(r["loop_closure_median_s"], 1, 1e3),
        "MB": number(r["peak_memory_bytes"], 0, 1e-6),
    }


@contextmanager
def _logs(paths: Sequence[Path]) -> Iterator[Sequence[Path]]:
    if paths:
        yield paths
        return
    from tempfile import TemporaryDirectory

    import numpy as np

    from slam.simulation.config import SimulationConfig
    from slam.simulation.simulation import write_simulation
    from slam.simulation.street_grid import generate_street_grid

    with TemporaryDirectory() as folder:
        path = Path(folder) / "simulated.mcap"
        write_simulation(path, generate_street_grid(rng=np.random.default_rng(0)), SimulationConfig(), seed=0)
        yield [path]
