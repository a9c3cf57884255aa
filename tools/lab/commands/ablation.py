"""dslam benchmark ablation: drives mapped with one part of the method off at a time."""

from __future__ import annotations

import json as json_text
import os
import re
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from tools.arguments import ConfigFile, Json, Settings
from tools.lab.tables import UNDEFINED, Markdown, report

if TYPE_CHECKING:
    from slam.common.config import Config
    from slam.evaluation.comparison import Comparison

NOISE = "position_noise=0.001,odometry_translation_noise=0.001"
"""Of each copy: far below that of any sensor, so that copies differ only by chance."""

FIGURES = ("trajectory.ate_m", "closures.precision", "closures.recall", "relocalization.success_rate",
           "associations.precision")  # fmt: skip


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
    import pandas as pd

    from slam.common.config import load_config
    from slam.evaluation.comparison import RULE
    from slam.evaluation.report.figures import HEADLINE_FIGURES
    from tools.lab.drives.ablation_drives import DRIVES
    from tools.lab.drives.ablation_parts import DEFAULT, PARTS

    drives = _chosen(drive, DRIVES, "--drive")
    parts = list(dict.fromkeys([DEFAULT, *_chosen(part, PARTS, "--part")]))
    configs = {name: load_config(config_file, [*(settings or ()), *PARTS[name].settings]) for name in parts}
    compared = {
        name: _compare_parts(name, data, folder / _file_name(name), configs, copies, jobs or os.cpu_count() or 1)
        for name in drives
    }
    tables = pd.concat({name: each.to_table().T for name, each in compared.items()}, names=["drive", "off"])
    headings = [figure.heading for figure in HEADLINE_FIGURES if figure.key in FIGURES]
    rows = tables.reindex(columns=headings).astype(object).fillna(UNDEFINED).reset_index().to_dict("records")
    report(
        [{str(heading): cell for heading, cell in row.items()} for row in rows],
        f"{copies} copies with the noise {NOISE}, seeds 0 to {copies - 1}: mean ± deviation. {RULE}",
        texts=["off"],
        markdown=markdown,
        json={name: each.to_json_dict() for name, each in compared.items()} if json else None,
    )


def _chosen(names: Sequence[str] | None, there: Mapping[str, object], option: str) -> list[str]:
    """The chosen names, in the order of the table; all if none is chosen."""
    for name in names or ():
        if name not in there:
            raise typer.BadParameter(f"there is no {name!r}; there are: {'; '.join(there)}.", param_hint=option)
    return [name for name in there if not names or name in names]


def _compare_parts(
    drive: str, data: Path, folder: Path, configs: Mapping[str, Config], copies: int, jobs: int
) -> Comparison:
    """Map the copies of a drive without each part; ``folder`` keeps the log and the copies that are finished."""
    from slam.evaluation.comparison import Run, compare_runs
    from slam.sweeps.degradations import parse_degradations
    from slam.sweeps.sweep import run_sweep
    from tools import console
    from tools.lab.drives.ablation_drives import DRIVES
    from tools.lab.drives.ablation_parts import DEFAULT, compute_without

    folder.mkdir(parents=True, exist_ok=True)
    log = folder / "drive.mcap"
    if not log.exists():
        DRIVES[drive](log, data)
    with console.progress_bar(drive, drive) as move:
        sweep = run_sweep(
            log,
            folder,
            parse_degradations([NOISE])[1:],
            configs[DEFAULT],
            seeds=copies,
            jobs=jobs,
            variants=configs,
            on_progress=move,
            compute=compute_without,
        )
    for failure in sweep.failures:
        typer.echo(f"{drive}: {failure}", err=True)
    return compare_runs(
        [
            Run(cell.name, result.evaluation or {}, json_text.dumps({"off": cell.variant}))
            for cell, result in sweep.results.items()
        ]
    )


def _file_name(name: str) -> str:
    return re.sub(r"\W+", "_", name)
