"""dslam benchmark ablation: drives mapped with one part of the method off at a time."""

from __future__ import annotations

import os
import re
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from tools.arguments import ConfigFile, Json, Settings

if TYPE_CHECKING:
    from slam.common.config import Config
    from slam.sweeps.sweep import Sweep, SweepRow

DEFAULT = "nothing"
PARTS: dict[str, tuple[str, ...]] = {
    DEFAULT: (),
    "descriptor: random vectors": ("loop_closure.descriptor=random",),
    "propagation of closures": ("loop_closure.propagation_distance_m=0",),
    "hypotheses": ("localization.max_hypotheses=0",),
    "posterior: first candidate": ("localization.error_probability=0.999999",),
    "loop closures": ("loop_closure.enabled=false",),
    "weight of landmarks": ("calibration.detection.covariance_inflation=1000000",),
    "labels": ("calibration.objects.max_classes=1",),
    "calibration": ("calibrate=false",),
}
"""Settings that switch a part off."""

NOISE = "position_noise=0.001,odometry_translation_noise=0.001"
"""Of each copy: far below that of any sensor, so that copies differ only by chance."""

FIGURES = ("trajectory.ate_m", "closures.precision", "closures.recall", "relocalization.success_rate",
           "associations.precision")  # fmt: skip
BEGIN, END = "<!-- begin of dslam benchmark ablation -->\n", "<!-- end of dslam benchmark ablation -->\n"


def ablation(
    data: Annotated[
        Path, typer.Argument(metavar="DATA", help="Folder with cities, kitti00 and robots.", show_default=False)
    ],
    folder: Annotated[
        Path, typer.Option("--output", "-o", metavar="DIR", help="Folder of the results; finished ones are kept.")
    ],
    page: Annotated[
        Path | None,
        typer.Option(metavar="PAGE.md", help="Put the table into that page, between its marks.", show_default=False),
    ] = None,
    drive: Annotated[list[str] | None, typer.Option(metavar="NAME", help="Only that drive. Repeatable.")] = None,
    part: Annotated[
        list[str] | None, typer.Option(metavar="NAME", help="Only that part, and with all parts. Repeatable.")
    ] = None,
    copies: Annotated[int, typer.Option(min=1, help="Copies of each drive, each with other noise of 1e-3.")] = 10,
    jobs: Annotated[
        int | None, typer.Option(min=1, help="Processes. \\[default: one a core]", show_default=False)
    ] = None,
    config_file: ConfigFile = None,
    settings: Settings = None,
    json: Json = False,
) -> None:
    """Map drives with one part of the method off at a time, and compare with all parts.

    Each drive is mapped with several copies of little noise, so that an effect can be told from a draw. If it is
    killed, the same command continues where it was.

    Example: dslam benchmark ablation data -o out/ablation --drive demo --part calibration --copies 3
    """
    from logs.storage.placement import write_text
    from slam.common.config import load_config
    from tools import console
    from tools.lab.drives.ablation_drives import DRIVES

    drives = _chosen(drive, DRIVES, "--drive")
    parts = [DEFAULT, *(name for name in _chosen(part, PARTS, "--part") if name != DEFAULT)]
    variants = {name: load_config(config_file, [*(settings or ()), *PARTS[name]]) for name in parts}
    sweeps = dict[str, "Sweep"]()
    for name, sweep in _run(drives, data, folder, variants, copies, jobs or os.cpu_count() or 1):
        sweeps[name] = sweep
        if page is not None:  # after each drive, for they may take hours
            write_text(page, _with_block(page, "\n".join([_conditions(copies, settings or ()), "", *_table(sweeps)])))
        for failure in sweep.failures:
            typer.echo(f"{name}: {failure}", err=True)
    if json:
        console.show_json({name: sweep.to_json_dict() for name, sweep in sweeps.items()})
    elif page is None:
        typer.echo("\n".join(_table(sweeps)))


def _chosen(names: Sequence[str] | None, there: Mapping[str, object], option: str) -> list[str]:
    """The names that are asked for, in the order of the table; all without any."""
    for name in names or ():
        if name not in there:
            raise typer.BadParameter(f"there is no {name!r}; there are: {'; '.join(there)}.", param_hint=option)
    return [name for name in there if not names or name in names]


def _run(
    drives: Sequence[str], data: Path, folder: Path, variants: Mapping[str, Config], copies: int, jobs: int
) -> Iterator[tuple[str, Sweep]]:
    """Sweep over each drive: the log is written once, and each cell that is finished is kept in ``folder``."""
    from slam.sweeps.degradations import parse_degradations
    from slam.sweeps.sweep import run_sweep
    from tools import console
    from tools.lab.drives.ablation_drives import DRIVES

    noise = [each for each in parse_degradations([NOISE]) if not each.is_undegraded]
    for name in drives:
        own = folder / re.sub(r"\W+", "_", name)
        own.mkdir(parents=True, exist_ok=True)
        log = own / "drive.mcap"
        if not log.exists():
            DRIVES[name](log, data)
        with console.progress_bar(name, name) as move:
            all_parts = variants[DEFAULT]
            yield (
                name,
                run_sweep(log, own, noise, all_parts, seeds=copies, jobs=jobs, variants=variants, on_progress=move),
            )


def _table(sweeps: Mapping[str, Sweep]) -> Iterator[str]:
    """Rows of Markdown: drive, part that is off, mean and worst of each figure, and the figures that it changes."""
    from slam.evaluation.report.figures import HEADLINE_FIGURES

    headings = [figure.heading for figure in HEADLINE_FIGURES if figure.key in FIGURES]
    yield f"| drive | off | {' | '.join(headings)} | beyond the spread |"
    yield f"|---|---|{'---:|' * len(headings)}---|"
    for name, sweep in sweeps.items():
        for row in sweep.rows:
            yield f"| {name} | {row.variant} | {' | '.join(_figures(row))} | {_changed(sweep.rows[0], row)} |"


def _figures(row: SweepRow) -> Iterator[str]:
    """Mean and worst of each figure; of how many copies, where it is not defined in all."""
    from slam.evaluation.metrics.statistics import UNDEFINED
    from slam.evaluation.report.figures import HEADLINE_FIGURES

    evaluations = [result.evaluation or {} for _, result in row.results]
    for figure in HEADLINE_FIGURES:
        if figure.key not in FIGURES:
            continue
        values = [value for each in evaluations if (value := figure.of(each)) is not None]
        if not values:
            yield UNDEFINED
            continue
        worst = max(values) if figure.is_error else min(values)
        part = "" if len(values) == len(evaluations) else f" ({len(values)} of {len(evaluations)})"
        yield f"{sum(values) / len(values):.{figure.digits}f}, {worst:.{figure.digits}f}{part}"


def _changed(default: SweepRow, row: SweepRow) -> str:
    """The figures whose means differ by more than the spread of the copies explains, by how much."""
    from slam.evaluation.comparison import Run, compare_runs
    from slam.evaluation.report.figures import HEADLINE_FIGURES

    runs = [
        Run(f"{each.variant} {number}", result.evaluation, f'{{"variant": "{each.variant}"}}')
        for each in (default, row)
        for number, (_, result) in enumerate(each.results)
        if result.evaluation is not None
    ]
    if row is default or len(runs) < 2:
        return ""
    figures = {figure.key: figure for figure in HEADLINE_FIGURES if figure.key in FIGURES}
    return ", ".join(
        f"{figures[each.key].heading} {each.difference:+.{figures[each.key].digits}f}"
        for each in compare_runs(runs, tuple(figures.values())).marked
    )


def _conditions(copies: int, settings: Sequence[str]) -> str:
    from importlib.metadata import version

    from slam.evaluation.comparison import RULE
    from tools.lab.drives.ablation_drives import SEED

    changed = ", ".join(settings) or "all default"
    return (
        f"Version {version('descriptellation-slam')}; settings: {changed}; {copies} copies with the noise "
        f"`{NOISE}` and the seeds 0 to {copies - 1}; simulated drives have the seed {SEED}. Each figure: mean, "
        f"worst. {RULE}"
    )


def _with_block(page: Path, block: str) -> str:
    """The text of the page with the block between its marks; a new page where there is none."""
    text = page.read_text(encoding="utf-8") if page.exists() else f"# Ablation\n\n{BEGIN}{END}"
    before, begin, rest = text.partition(BEGIN)
    _, end, after = rest.partition(END)
    if not begin or not end:
        raise typer.BadParameter(f"{page} has no lines {BEGIN.strip()} and {END.strip()}.", param_hint="--page")
    return f"{before}{BEGIN}{block}\n{END}{after}"
