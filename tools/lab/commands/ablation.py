"""dslam benchmark ablation: drives mapped with one part of the method off at a time."""

from __future__ import annotations

import os
import re
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from tools.arguments import ConfigFile, Jobs, Json, Settings
from tools.lab.tables import Markdown, ResultFolder, report, rows_of

if TYPE_CHECKING:
    from slam.common.config import Config
    from slam.sweeps.sweep import Sweep

NOISE = "position_noise=0.001,odometry_translation_noise=0.001"
"""Of each copy: far below that of any sensor, so that copies differ only by chance."""


def ablation(
    data: Annotated[
        Path, typer.Argument(metavar="DATA", help="Folder with cities, kitti00 and robots.", show_default=False)
    ],
    folder: ResultFolder,
    drive: Annotated[list[str] | None, typer.Option(metavar="NAME", help="Only this drive. Repeatable.")] = None,
    part: Annotated[
        list[str] | None,
        typer.Option(metavar="NAME", help="Only this part; the row with all parts is always measured. Repeatable."),
    ] = None,
    copies: Annotated[
        int, typer.Option(min=1, help="Perturbed copies of each drive, each with its own noise (1e-3).")
    ] = 10,
    jobs: Jobs = None,
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
    from tools.lab.drives.ablation_drives import DRIVES
    from tools.lab.drives.ablation_parts import DEFAULT, PARTS

    drives = _chosen(drive, DRIVES, "--drive")
    parts = dict.fromkeys([DEFAULT, *_chosen(part, PARTS, "--part")])
    variants = {name: load_config(config_file, [*(settings or ()), *PARTS[name].settings]) for name in parts}
    swept = {name: _map_copies(name, data, folder, variants, copies, jobs or os.cpu_count() or 1) for name in drives}
    compared = {name: each.compare() for name, each in swept.items()}
    rows = pd.concat({name: rows_of(each) for name, each in compared.items()}, names=["drive"]).reset_index("drive")
    report(
        rows.to_dict("records"),
        f"{copies} copies with the noise {NOISE}, seeds 0 to {copies - 1}: mean ± deviation. {RULE}",
        *(failure for each in swept.values() for failure in each.failures),
        texts=["runs"],
        markdown=markdown,
        json={name: each.to_json_dict() for name, each in compared.items()} if json else None,
    )


def _chosen(names: Sequence[str] | None, there: Mapping[str, object], option: str) -> list[str]:
    """The names that are asked for, in the order of the table; all without any."""
    for name in names or ():
        if name not in there:
            raise typer.BadParameter(f"there is no {name!r}; there are: {'; '.join(there)}.", param_hint=option)
    return [name for name in there if not names or name in names]


def _map_copies(drive: str, data: Path, folder: Path, variants: Mapping[str, Config], copies: int, jobs: int) -> Sweep:
    """Map the copies of a drive without each part; ``folder`` keeps the log and the copies that are finished."""
    from slam.sweeps.sweep import plan_sweep, run_sweep
    from tools import console
    from tools.lab.drives.ablation_drives import DRIVES
    from tools.lab.drives.ablation_parts import map_without

    of_drive = folder / re.sub(r"\W+", "_", drive)
    of_drive.mkdir(parents=True, exist_ok=True)
    log = of_drive / "drive.mcap"
    if not log.exists():
        DRIVES[drive](log, data)
    tasks = plan_sweep(log, [NOISE], variants, seeds=copies)
    with console.progress_bar(drive, drive) as move:
        return run_sweep(tasks, of_drive, jobs=jobs, on_progress=move, compute=map_without)
