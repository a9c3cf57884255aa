"""dslam benchmark."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from tools.arguments import ConfigFile, Json, Settings
from tools.lab.commands import (
    ablation,
    closures,
    descriptors,
    faults,
    fleet,
    kidnapping,
    recall,
    relocalization,
    retrieval,
    robots,
)

if TYPE_CHECKING:
    from tools.lab.descriptors.registration import RegistrationBenchmark
    from tools.lab.drives.replay import ReplayBenchmark

app = typer.Typer(help="Measure speed, memory and success.", no_args_is_help=True)
app.command()(closures.closures)
app.command()(descriptors.descriptors)
app.command()(faults.faults)
app.command()(fleet.fleet)
app.command()(kidnapping.kidnapping)
app.command()(ablation.ablation)
app.command("map-size")(descriptors.map_size)
app.command()(recall.recall)
app.command()(relocalization.relocalization)
app.command()(retrieval.retrieval)
app.command()(robots.robots)


@app.callback()
def _benchmark() -> None:
    """Measure speed, memory and success."""


@app.command()
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
    from dataclasses import asdict

    from slam.common.config import load_config
    from tools import console
    from tools.lab.drives.replay import benchmark_replay

    config = load_config(config_file, settings or ())
    with _logs(logs or []) as paths:
        results = [benchmark_replay(path, config, runs=runs) for path in paths]
    if json:
        console.show_json({"logs": [asdict(result) for result in results]})
    else:
        _show(results)


@app.command()
def registration(
    seed: Annotated[int, typer.Option(min=0, help="Seed of the problems.")] = 0,
    trials: Annotated[int, typer.Option(min=1, help="Problems of each kind; a quarter of them for 5000.")] = 20,
    json: Json = False,
) -> None:
    """Register constellations from correspondences most of which are false, beside Open3D and KISS-Matcher.

    Example: dslam benchmark registration --trials 5
    """
    from dataclasses import asdict

    from tools import console
    from tools.lab.descriptors.registration import benchmark_registration

    result = benchmark_registration(seed=seed, trials=trials)
    if json:
        console.show_json(asdict(result))
    else:
        _show_registration(result)


@contextmanager
def _logs(paths: list[Path]) -> Iterator[list[Path]]:
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


def _show(results: list[ReplayBenchmark]) -> None:
    from tools import console

    headings = ("log s", "wall s", "x real time", "GTSAM", "own", "stall ms", "closing ms", "MB")
    table = console.grid({"log": False, **dict.fromkeys(headings, True)})
    for r in results:
        wall = f"{r.wall_s:.2f}" if r.runs == 1 else f"{r.wall_s:.2f} ({r.wall_min_s:.2f}-{r.wall_max_s:.2f})"
        table.add_row(
            Path(r.log).name,
            f"{r.log_s:.0f}",
            wall,
            f"{r.real_time_factor:.1f}",
            f"{100 * r.solver_share:.0f} %",
            f"{100 * r.own_share:.0f} %",
            f"{1e3 * r.max_message_latency_s:.0f}",
            f"{1e3 * r.loop_closure_median_s:.1f}",
            f"{r.peak_memory_bytes / 1e6:.0f}",
        )
    console.show(table)


def _show_registration(result: RegistrationBenchmark) -> None:
    from tools import console

    headings = ("pairs", "false", "true", "success", "error m", "deg", "ms", "fastest")
    table = console.grid({"method": False, **dict.fromkeys(headings, True)})
    for c in result.cells:
        table.add_row(
            c.method,
            str(c.correspondences),
            f"{100 * c.false_share:.0f} %",
            str(c.true_correspondences),
            f"{100 * c.success:.0f} %",
            "-" if c.median_error_m is None else f"{c.median_error_m:.2f}",
            "-" if c.median_error_deg is None else f"{c.median_error_deg:.2f}",
            f"{c.median_ms:.2f}",
            f"{c.fastest_ms:.2f}",
        )
    for name, why in result.unavailable.items():
        table.add_row(f"{name}: not measured, {why}", *[""] * len(headings))
    console.show(table)
    console.show("Fewer than 3 true correspondences determine nothing that chance does not.")
