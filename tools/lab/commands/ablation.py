"""dslam benchmark ablation: drives mapped with one part of the method off at a time."""

from __future__ import annotations

import os
import re
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from tools.arguments import ConfigFile, Json, Settings
from tools.lab.tables import Markdown, Row, number, report

if TYPE_CHECKING:
    from slam.common.config import Config
    from slam.evaluation.report.figures import Figure
    from slam.sweeps.sweep import Sweep

NOISE = "position_noise=0.001,odometry_translation_noise=0.001"
"""Of each copy: far below that of any sensor, so that copies differ only by chance."""

FIGURES = ("trajectory.ate_m", "closures.precision", "closures.recall", "relocalization.success_rate",
           "associations.precision")  # fmt: skip
CHANGED = "beyond the spread"


def ablation(
    data: Annotated[
        Path, typer.Argument(metavar="DATA", help="Folder with cities, kitti00 and robots.", show_default=False)
    ],
    folder: Annotated[
        Path, typer.Option("--output", "-o", metavar="DIR", help="Folder of the results; finished ones are reused.")
    ],
    drive: Annotated[list[str] | None, typer.Option(metavar="NAME", help="Only this drive. Repeatable.")] = None,
    part: Annotated[
        list[str] | None,
        typer.Option(metavar="NAME", help="Only this part; the row with all parts is always measured. Repeatable."),
    ] = None,
    copies: Annotated[
        int, typer.Option(min=1, help="Perturbed copies of each drive, each with its own noise (1e-3).")
    ] = 10,
    jobs: Annotated[
        int | None, typer.Option(min=1, help="Processes. \\[default: one per core]", show_default=False)
    ] = None,
    config_file: ConfigFile = None,
    settings: Settings = None,
    markdown: Markdown = False,
    json: Json = False,
) -> None:
    """Map drives with one part of the method switched off at a time, and compare with the whole method.

    Each drive is mapped in several copies with a little noise, to distinguish effects from chance. After an
    interruption the same command continues.

    Example: dslam benchmark ablation data -o out/ablation --drive demo --part calibration --copies 3
    """
    from slam.common.config import load_config
    from slam.evaluation.comparison import RULE
    from tools.lab.drives.ablation_drives import DRIVES
    from tools.lab.drives.ablation_parts import DEFAULT, PARTS

    drives = _chosen(drive, DRIVES, "--drive")
    parts = list(dict.fromkeys([DEFAULT, *_chosen(part, PARTS, "--part")]))
    configs = {name: load_config(config_file, [*(settings or ()), *PARTS[name].settings]) for name in parts}
    sweeps = dict[tuple[str, str], "Sweep"]()
    for key, sweep in _run(drives, data, folder, configs, copies, jobs or os.cpu_count() or 1):
        sweeps[key] = sweep
        for failure in sweep.failures:
            typer.echo(f"{key[0]}: {failure}", err=True)
    found = [{"drive": name, **each.to_json_dict()} for (name, _), each in sweeps.items()] if json else []
    note = f"{copies} copies with the noise {NOISE}, seeds 0 to {copies - 1}. Each figure: mean, worst. {RULE}"
    report(_rows(sweeps), note, texts=("off", CHANGED), markdown=markdown, json={"rows": found} if json else None)


def _chosen(names: Sequence[str] | None, there: Mapping[str, object], option: str) -> list[str]:
    """The names that are asked for, in the order of the table; all without any."""
    for name in names or ():
        if name not in there:
            raise typer.BadParameter(f"there is no {name!r}; there are: {'; '.join(there)}.", param_hint=option)
    return [name for name in there if not names or name in names]


def _run(
    drives: Sequence[str], data: Path, folder: Path, configs: Mapping[str, Config], copies: int, jobs: int
) -> Iterator[tuple[tuple[str, str], Sweep]]:
    """A sweep for each drive and part; ``folder`` keeps the log of the drive and each cell that is finished."""
    from slam.sweeps.degradations import parse_degradations
    from slam.sweeps.sweep import run_sweep
    from tools import console
    from tools.lab.drives.ablation_drives import DRIVES
    from tools.lab.drives.ablation_parts import compute_without

    noise = parse_degradations([NOISE])[1:]
    for drive in drives:
        own = folder / _file_name(drive)
        own.mkdir(parents=True, exist_ok=True)
        log = own / "drive.mcap"
        if not log.exists():
            DRIVES[drive](log, data)
        for part, config in configs.items():
            with console.progress_bar(drive, part) as move:
                sweep = run_sweep(
                    log,
                    own / _file_name(part),
                    noise,
                    config,
                    seeds=copies,
                    jobs=jobs,
                    variants={part: config},
                    on_progress=move,
                    compute=compute_without,
                )
            yield (drive, part), sweep


def _file_name(name: str) -> str:
    return re.sub(r"\W+", "_", name)


def _rows(sweeps: Mapping[tuple[str, str], Sweep]) -> list[Row]:
    """Drive, part that is off, mean and worst of each figure, and the figures that it changes."""
    from tools.lab.drives.ablation_parts import DEFAULT

    return [
        {"drive": drive, "off": part, **_figures(sweep), CHANGED: _changed(sweeps[drive, DEFAULT], sweep)}
        for (drive, part), sweep in sweeps.items()
    ]


def _figures(sweep: Sweep) -> Row:
    """Mean and worst of each figure; of how many copies, where it is not defined in all."""
    cells = {}
    (copies,) = sweep.rows().values()
    for figure in _headline_figures():
        values = copies[figure.key].dropna()
        worst = values.max() if figure.is_error else values.min()
        part = "" if len(values) in (0, len(copies)) else f" ({len(values)} of {len(copies)})"
        both = f"{number(values.mean(), figure.digits)}, {number(worst, figure.digits)}{part}"
        cells[figure.heading] = both if len(values) else number(None, 0)
    return cells


def _changed(default: Sweep, sweep: Sweep) -> str:
    """The figures whose means differ by more than the spread of the copies explains, by how much."""
    from slam.evaluation.comparison import Run, compare_runs

    runs = [
        Run(name, evaluation, f'{{"variant": "{each.first.variant}"}}')
        for each in (default, sweep)
        for name, evaluation in each.evaluations.items()
    ]
    if sweep is default or len(runs) < 2:
        return ""
    figures = {figure.key: figure for figure in _headline_figures()}
    return ", ".join(
        f"{figures[each.key].heading} {each.difference:+.{figures[each.key].digits}f}"
        for each in compare_runs(runs, tuple(figures.values())).marked
    )


def _headline_figures() -> list[Figure]:
    from slam.evaluation.report.figures import HEADLINE_FIGURES

    return [figure for figure in HEADLINE_FIGURES if figure.key in FIGURES]
