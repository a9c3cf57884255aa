"""dslam benchmark relocalization."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Annotated, Any

import typer

from tools.arguments import ConfigFile, Json, Settings, Topics, parse_topics
from tools.lab.tables import number, percent, report

_Benchmark = Callable[..., dict[str, Any]]
RIGHT = (4.0, 10.0)
"""Largest error of a right fix in a real drive, in metres and degrees: that of a true closure in an evaluation."""
_ALWAYS = {"kidnaps", "max_travel", "config_file", "settings", "json"}
MODES = {
    "--log": _ALWAYS | {"log", "map_until", "topics"},
    "--map": _ALWAYS | {"map_log", "seed", "noise", "changed"},
    "--objects": _ALWAYS | {"objects", "trajectory", "map_log", "seed", "noise", "changed", "thin", "oracle", "jobs"},
}
"""The parameters of the command that go with each way to measure; without any of these options, with --objects."""


Objects = Annotated[
    Path | None, typer.Option(metavar="CSV", help="Objects of a world: x_m,y_m,z_m,class,id.", show_default=False)
]
Trajectory = Annotated[Path | None, typer.Option(metavar="CSV", help="Tour to map: x_m,y_m.", show_default=False)]
MapLog = Annotated[
    Path | None,
    typer.Option(
        "--map",
        metavar="MAP.mcap",
        help="Saved or imported map, in the frame of the objects, instead of a mapped tour.",
        show_default=False,
    ),
]
RealLog = Annotated[
    Path | None,
    typer.Option(metavar="LOG.mcap", help="A real drive with its truth instead of a world.", show_default=False),
]
MapUntil = Annotated[
    float | None,
    typer.Option(
        metavar="SECONDS", min=1.0, help="With --log: time in seconds at which the map ends.", show_default=False
    ),
]
Noise = Annotated[float, typer.Option(min=0.0, max=10.0, help="Factor on the errors of the sensor after mapping.")]
Changed = Annotated[float, typer.Option(min=0.0, max=1.0, help="Share of the objects replaced after mapping.")]
Thin = Annotated[float, typer.Option(metavar="FACTOR", min=1.0, help="Keep one in N objects before mapping.")]
WithOracle = Annotated[
    bool, typer.Option("--oracle", help="Also measure the ceiling: test all poses with all observations along 40 m.")
]
MaxTravel = Annotated[float, typer.Option("--max-travel", metavar="METRES", min=5.0, help="Length of each drive.")]


def relocalization(
    context: typer.Context,
    objects: Objects = None,
    trajectory: Trajectory = None,
    map_log: MapLog = None,
    log: RealLog = None,
    map_until: MapUntil = None,
    kidnaps: Annotated[int, typer.Option(min=1, help="Number of kidnappings.")] = 100,
    seed: Annotated[int, typer.Option(min=0, help="Seed of the map, the places and all errors.")] = 0,
    noise: Noise = 1.0,
    changed: Changed = 0.0,
    thin: Thin = 1.0,
    oracle: WithOracle = False,
    max_travel: MaxTravel = 60.0,
    jobs: Annotated[int, typer.Option(min=1, help="Parallel processes; one with --log.")] = 1,
    config_file: ConfigFile = None,
    settings: Settings = None,
    topics: Topics = None,
    json: Json = False,
) -> None:
    """Map a tour, kidnap the robot to random places of it, and measure how soon it is relocalized.

    The robot drives along the tour or against it until it is relocalized, and 10 m more. Found: a fix within 40 m with
    an error below 1 m and 3 deg in the world; in map: the same in the map, which may be bent; late: a right fix after
    40 m; wrong: any other fix; lost: no fix. Distance and time are medians of right fixes, errors are of all fixes;
    kept: right fixes that are still right after 10 m.

    With --log the first part of a real drive is mapped. The robot starts at places of the rest, evenly spread: half of
    them in the map, where it must be found, half outside, where it must not.

    Without --objects the world is a generated town.

    Example: dslam benchmark relocalization --kidnaps 20

    Example: dslam benchmark relocalization --objects objects.csv --trajectory trajectory.csv --noise 2 --changed 0.1

    Example: dslam benchmark relocalization --objects objects.csv --trajectory trajectory.csv --thin 5 --oracle

    With --map no tour is driven first: the map may be one of open data (dslam import). Without --objects the robot
    starts beside objects of that map, and drives straight along their row.

    Example: dslam benchmark relocalization --map trees_map.mcap --max-travel 150 --kidnaps 50

    Example: dslam benchmark relocalization --log kitti00.mcap --map-until 311 --kidnaps 40
    """
    from slam.common.config import load_config
    from tools import console

    mode = "--log" if log is not None else "--map" if map_log is not None and objects is None else "--objects"
    _refuse_options_of_other_modes(context, mode)
    config = load_config(config_file, settings or ())
    chances = {"seed": seed, "noise": noise, "changed": changed}
    run: _Benchmark
    if log is not None:
        conditions: dict[str, Any] = {"map_until_s": map_until}
        run = _on_log(log, map_until, parse_topics(topics))
    elif mode == "--map":
        conditions, run = chances, partial(_in_map(map_log), **chances)
    else:
        conditions = {**chances, "thin": thin, "oracle": oracle}
        run = partial(_in_world(objects, trajectory, map_log, seed), jobs=jobs, **conditions)
    with console.progress_bar("relocalizing", "relocalizing") as move:
        result = run(config, kidnaps=kidnaps, max_travel_m=max_travel, on_progress=move)
    _report(result, conditions | {"max_travel_m": max_travel}, as_json=json)


def _refuse_options_of_other_modes(context: typer.Context, mode: str) -> None:
    wrong = [
        parameter.opts[0]
        for parameter in context.command.params
        if parameter.name is not None
        and parameter.name not in MODES[mode]
        and getattr(context.get_parameter_source(parameter.name), "name", "") == "COMMANDLINE"
    ]
    if wrong:
        why = "only with --log" if mode == "--objects" else f"not with {mode}"
        raise typer.BadParameter(f"{why}.", param_hint=", ".join(wrong))


def _on_log(log: Path, map_until_s: float | None, topics: dict[str, str]) -> _Benchmark:
    from tools.lab.relocalization.logged import benchmark_log
    from tools.lab.relocalization.trial import Tolerance

    if map_until_s is None:
        raise typer.BadParameter("use it with --map-until.", param_hint="--log")
    return partial(benchmark_log, log, map_until_s=map_until_s, tolerance=Tolerance(*RIGHT), topics=topics)


def _in_map(map_log: Path | None) -> _Benchmark:
    from slam.localization.prior_map import load_prior_map
    from tools.lab.relocalization.worlds import benchmark_in_map

    assert map_log is not None
    return partial(benchmark_in_map, load_prior_map(map_log))


def _in_world(objects: Path | None, trajectory: Path | None, map_log: Path | None, seed: int) -> _Benchmark:
    import numpy as np

    from slam.localization.prior_map import load_prior_map
    from slam.simulation.street_grid import generate_street_grid
    from slam.simulation.world import load_world
    from tools.lab.relocalization.worlds import benchmark_relocalization

    if objects is not None and trajectory is not None:
        world = load_world(objects, trajectory)
    elif objects is None and trajectory is None:
        world = generate_street_grid(rng=np.random.default_rng(seed))
    else:
        raise typer.BadParameter("give both, or none for a generated town.", param_hint="--objects and --trajectory")
    prior_map = None if map_log is None else load_prior_map(map_log)
    return partial(benchmark_relocalization, world, prior_map=prior_map)


def _report(result: dict[str, Any], conditions: dict[str, Any], *, as_json: bool) -> None:
    from slam.evaluation.place_recognition.reliability import SURE

    reliability, kidnaps = result["reliability"], result.get("elsewhere_kidnaps")
    notes = [
        "found, in map, late, wrong and lost: per cent of the drives; kept: per cent of the right fixes",
        f"fixes at a wrong place of the map: {percent(result['misplaced_rate'])} %; other wrong fixes are due to "
        "errors of the map",
        f"wrong fixes corrected within 10 m, in per cent: {percent(result['revoked_rate'], 0)}",
        f"places with a posterior probability of {SURE:g} or more: {reliability['sure_count']}, of which right in the "
        f"map: {reliability['sure_right']}",
        f"loading the map: {number(result['load_s'], 0, 1e3)} ms; a search: {number(result['query_ms'], 1)} ms",
    ]
    if result.get("oracle_rate") is not None:
        notes.append(f"could be found: {percent(result['oracle_rate'])} %")
    if kidnaps is not None:
        notes.append(f"outside the map: {result['elsewhere_fixes']} false fixes in {kidnaps} drives")
    title = (
        f"{result['world']}: {result['tour_m']:.0f} m, {result['landmarks']} landmarks, map ATE "
        f"{result['map_ate_m']:.2f} m; {', '.join(f'{name} {value}' for name, value in conditions.items())}"
    )
    rows = [_row(name, figures) for name, figures in {"everywhere": result, **result["groups"]}.items()]
    report(rows, *notes, title=title, json={**conditions, **result} if as_json else None)


def _row(where: str, figures: dict[str, Any]) -> dict[str, str]:
    return {
        "where": where,
        "drives": str(figures["kidnaps"]),
        "found": percent(figures["success_rate"]),
        "in map": percent(figures["success_in_map_rate"]),
        "late": percent(figures["late_rate"]),
        "wrong": percent(figures["false_relocalization_rate"]),
        "lost": percent(figures["not_found_rate"]),
        "m": number(figures["median_distance_m"], 1),
        "95 %": number(figures["p95_distance_m"], 1),
        "s": number(figures["median_seconds"], 1),
        "off m": number(figures["median_error_m"], 2),
        "95 % off": number(figures["p95_error_m"], 2),
        "deg": number(figures["median_error_deg"], 2),
        "kept": percent(figures["kept_rate"], 0),
    }
