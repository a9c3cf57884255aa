"""dslam benchmark relocalization."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from tools.arguments import ConfigFile, Json, Settings, Topics, parse_topics
from tools.lab.tables import number, percent, show

if TYPE_CHECKING:
    from slam.common.config import Config
    from tools.lab.relocalization.figures import Figures, RelocalizationBenchmark
    from tools.lab.relocalization.logged import LoggedRelocalization

RIGHT = (4.0, 10.0)


Objects = Annotated[
    Path | None, typer.Option(metavar="CSV", help="Objects of a world: x_m,y_m,z_m,class,id.", show_default=False)
]
Trajectory = Annotated[
    Path | None, typer.Option(metavar="CSV", help="Tour that is mapped: x_m,y_m.", show_default=False)
]
MapLog = Annotated[
    Path | None,
    typer.Option(
        "--map",
        metavar="MAP.mcap",
        help="Search in that map, in the frame of the objects, instead of driving.",
        show_default=False,
    ),
]
RealLog = Annotated[
    Path | None,
    typer.Option(metavar="LOG.mcap", help="A real drive with its truth instead of a world.", show_default=False),
]
MapUntil = Annotated[
    float | None,
    typer.Option(metavar="SECONDS", min=1.0, help="With --log: what makes the map ends there.", show_default=False),
]
Right = Annotated[
    tuple[float, float], typer.Option(metavar="METRES DEGREES", help="With --log: most error of a right fix.")
]
Noise = Annotated[
    float, typer.Option(min=0.0, max=10.0, help="Factor on the errors of the sensor after the map was made.")
]
Changed = Annotated[float, typer.Option(min=0.0, max=1.0, help="Share of the objects replaced after the map was made.")]
Thin = Annotated[float, typer.Option(metavar="FACTOR", min=1.0, help="Keep one of N objects before the map is made.")]
WithOracle = Annotated[
    bool, typer.Option("--oracle", help="Also measure what could be found: all poses, all observations of 40 m.")
]
MaxTravel = Annotated[float, typer.Option("--max-travel", metavar="METRES", min=5.0, help="How long each drive is.")]


def relocalization(
    objects: Objects = None,
    trajectory: Trajectory = None,
    map_log: MapLog = None,
    log: RealLog = None,
    map_until: MapUntil = None,
    right: Right = RIGHT,
    kidnaps: Annotated[int, typer.Option(min=1, help="How often the robot is kidnapped.")] = 100,
    seed: Annotated[int, typer.Option(min=0, help="Seed of the map, the places and all errors.")] = 0,
    noise: Noise = 1.0,
    changed: Changed = 0.0,
    thin: Thin = 1.0,
    oracle: WithOracle = False,
    max_travel: MaxTravel = 60.0,
    jobs: Annotated[int, typer.Option(min=1, help="Processes that search at a time; with --log one.")] = 1,
    config_file: ConfigFile = None,
    settings: Settings = None,
    topics: Topics = None,
    json: Json = False,
) -> None:
    """Map a tour, kidnap the robot to random places of it, and measure how soon it is relocalized.

    It drives from there along the tour or against it, until objects of the map are recognised, and 10 m more. Found: a
    fix within 40 m that is right to 1 m and 3 deg in the world; in map: ... or in the map, which may itself be bent;
    late: a right one after that; wrong: any other in the world; lost: none at all. Distance and time are medians of
    right fixes, errors of all fixes; kept: right fixes that are still right 10 m on.

    With --log the first part of a real drive makes the map, and the robot is put down at places of the rest, evenly
    spread: some where the map has been, and some where it has not, at which it must not be found.

    Without --objects the world is a generated town.

    Example: dslam benchmark relocalization --kidnaps 20

    Example: dslam benchmark relocalization --objects objects.csv --trajectory trajectory.csv --noise 2 --changed 0.1

    Example: dslam benchmark relocalization --objects objects.csv --trajectory trajectory.csv --thin 5 --oracle

    With --map no tour is driven first: the map may be one of open data (dslam import). Without --objects the robot is
    put down beside objects of that map, and goes straight on along the row in which they stand.

    Example: dslam benchmark relocalization --map trees_map.mcap --max-travel 150 --kidnaps 50

    Example: dslam benchmark relocalization --log kitti00.mcap --map-until 311 --kidnaps 40
    """
    from slam.common.config import load_config

    chosen = parse_topics(topics)
    config = load_config(config_file, settings or ())
    conditions = {"seed": seed, "noise": noise, "changed": changed, "thin": thin, "oracle": oracle}
    conditions["max_travel_m"] = max_travel
    if log is not None:
        if objects is not None or trajectory is not None or map_log is not None or map_until is None:
            raise typer.BadParameter(
                "it goes with --map-until, and without --objects, --trajectory and --map.", param_hint="--log"
            )
        _check_log(right, conditions, jobs)
        _run_log(log, config, map_until, kidnaps, max_travel, right, chosen, as_json=json)
        return
    if (objects is None) != (trajectory is None):
        raise typer.BadParameter("give both, or none for a generated town.", param_hint="--objects and --trajectory")
    if objects is None and map_log is not None:
        if topics or right != RIGHT or (map_until, thin, oracle, jobs) != (None, 1.0, False, 1):
            raise typer.BadParameter("they go with --objects or --log.", param_hint="--thin, --oracle, --jobs, ...")
        chances = {"seed": seed, "noise": noise, "changed": changed, "max_travel_m": max_travel}
        _run_map(map_log, config, kidnaps, chances, as_json=json)
        return
    if map_until is not None or topics or right != RIGHT:
        raise typer.BadParameter("they go with --log.", param_hint="--map-until, --right and --topic")
    _run_world(objects, trajectory, map_log, config, kidnaps, jobs, conditions, as_json=json)


def _check_log(right: tuple[float, float], conditions: dict[str, Any], jobs: int) -> None:
    """Refuse options that do not go with --log."""
    as_it_is = {"seed": 0, "noise": 1.0, "changed": 0.0, "thin": 1.0, "oracle": False}
    if jobs != 1 or any(conditions[name] != value for name, value in as_it_is.items()):
        raise typer.BadParameter("a log is as it is; they go with --objects.", param_hint="--seed, --noise, ...")
    if not min(right) > 0.0:
        raise typer.BadParameter(f"{right[0]:g} m and {right[1]:g} deg must be above 0.", param_hint="--right")


def _run_world(
    objects: Path | None,
    trajectory: Path | None,
    map_log: Path | None,
    config: Config,
    kidnaps: int,
    jobs: int,
    conditions: dict[str, Any],
    *,
    as_json: bool,
) -> None:
    import numpy as np

    from slam.localization.prior_map import load_prior_map
    from slam.simulation.street_grid import generate_street_grid
    from slam.simulation.world import load_world
    from tools import console
    from tools.lab.relocalization.simulated import benchmark_relocalization

    if objects is not None and trajectory is not None:
        world = load_world(objects, trajectory)
    else:
        world = generate_street_grid(rng=np.random.default_rng(conditions["seed"]))
    with console.progress_bar("carrying off", "carrying off") as move:
        result = benchmark_relocalization(
            world,
            config,
            kidnaps=kidnaps,
            jobs=jobs,
            prior_map=load_prior_map(map_log) if map_log is not None else None,
            on_progress=move,
            **conditions,
        )
    _tell(result, conditions, as_json=as_json)


def _run_map(map_log: Path, config: Config, kidnaps: int, conditions: dict[str, Any], *, as_json: bool) -> None:
    from slam.localization.prior_map import load_prior_map
    from tools import console
    from tools.lab.relocalization.unknown_streets import benchmark_in_map

    known = load_prior_map(map_log)
    with console.progress_bar("carrying off", "carrying off") as move:
        result = benchmark_in_map(known, config, kidnaps=kidnaps, on_progress=move, **conditions)
    _tell(result, conditions, as_json=as_json)


def _tell(result: RelocalizationBenchmark, conditions: dict[str, Any], *, as_json: bool) -> None:
    if as_json:
        _show_json(result, conditions)
    else:
        _show(result, f"noise x {conditions['noise']:g}, {100 * conditions['changed']:g} % of the objects changed")


def _run_log(
    log: Path,
    config: Config,
    map_until_s: float,
    kidnaps: int,
    max_travel_m: float,
    right: tuple[float, float],
    topics: dict[str, str],
    *,
    as_json: bool,
) -> None:
    from dataclasses import asdict

    from tools import console
    from tools.lab.relocalization.figures import Tolerance
    from tools.lab.relocalization.logged import benchmark_log

    with console.progress_bar("carrying off", "carrying off") as move:
        result = benchmark_log(
            log,
            config,
            map_until_s=map_until_s,
            kidnaps=kidnaps,
            max_travel_m=max_travel_m,
            tolerance=Tolerance(*right),
            topics=topics,
            on_progress=move,
        )
    if as_json:
        elsewhere = {
            "elsewhere_kidnaps": len(result.elsewhere),
            "elsewhere_fixes": result.false_fixes,
            "elsewhere_outcomes": [asdict(each) for each in result.elsewhere],
        }
        _show_json(
            result.mapped, {"map_until_s": map_until_s, "max_travel_m": max_travel_m, "right": list(right), **elsewhere}
        )
        return
    _show(result.mapped, f"right within {right[0]:g} m and {right[1]:g} deg")
    _show_elsewhere(result)


def _show_json(result: RelocalizationBenchmark, conditions: dict[str, Any]) -> None:
    from tools import console

    figures = result.to_json_dict()
    console.show_json({**figures.pop("total"), **conditions, **figures})


def _show_elsewhere(result: LoggedRelocalization) -> None:
    from tools import console

    if not result.elsewhere:
        console.show("the rest of the drive stays near the map, so fixes elsewhere cannot be measured")
        return
    console.show(f"where the map has never been: {result.false_fixes} false fixes in {len(result.elsewhere)} drives")


def _show(result: RelocalizationBenchmark, conditions: str) -> None:
    from slam.evaluation.place_recognition.reliability import SURE

    title = (
        f"{result.world}: {result.tour_m:.0f} m, {result.landmarks} landmarks, map ATE {result.map_ate_m:.2f} m; "
        f"{conditions}"
    )
    show(
        [_row(name, figures) for name, figures in {"everywhere": result.total, **result.groups}.items()],
        "found, in map, late, wrong, lost and kept in per cent of the drives, kept of the right fixes",
        f"fixes at another place than in the map: {percent(result.total.misplaced_rate)} %; the others that "
        "are wrong are so because the map is",
        f"wrong fixes corrected within 10 m, in per cent: {percent(result.total.revoked_rate, 0)}",
        f"places with a posterior probability of {SURE:g} or more: {result.reliability.sure_count}, of which right in "
        f"the map: {result.reliability.sure_right}",
        *([] if result.oracle_rate is None else [f"could be found: {100 * result.oracle_rate:.1f} %"]),
        f"loading the map: {1e3 * result.load_s:.0f} ms; a search: {number(result.query_ms, 1)} ms",
        title=title,
    )


def _row(where: str, figures: Figures) -> dict[str, str]:
    return {
        "where": where,
        "drives": str(figures.kidnaps),
        "found": percent(figures.success_rate),
        "in map": percent(figures.success_in_map_rate),
        "late": percent(figures.late_rate),
        "wrong": percent(figures.false_relocalization_rate),
        "lost": percent(figures.not_found_rate),
        "m": number(figures.median_distance_m, 1),
        "95 %": number(figures.p95_distance_m, 1),
        "s": number(figures.median_seconds, 1),
        "off m": number(figures.median_error_m, 2),
        "95 % off": number(figures.p95_error_m, 2),
        "deg": number(figures.median_error_deg, 2),
        "kept": percent(figures.kept_rate, 0),
    }
