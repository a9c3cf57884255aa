"""dslam benchmark live."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from tools.arguments import ConfigFile, Json, Settings
from tools.lab.tables import Markdown, number, report, with_progress

if TYPE_CHECKING:
    from slam.sweeps.mapped_drive import MappedDrive

DEFAULT_DRIVES = ("demo", "greenhouse", "lost_in_the_woods", "mrclam6/robot2", "wild03", "kitti00")
COLUMNS = {"ATE": "trajectory.ate_m", "online": "trajectory.online_ate_m"}
NOTE = """\
ATE in metres, aligned by SE(3): of the final trajectory, and online, of the poses as they were published; of whole
drives after the first fifth of the way. In brackets: by that of the replay above, which knows the whole log first."""


def live(
    data: Annotated[Path, typer.Argument(metavar="DATA", help="Folder with kitti00 and robots.", show_default=False)],
    drive: Annotated[list[str] | None, typer.Option(metavar="NAME", help="Only this drive. Repeatable.")] = None,
    config_file: ConfigFile = None,
    settings: Settings = None,
    markdown: Markdown = False,
    json: Json = False,
) -> None:
    """Map drives live and compare with replays: by a calibration of the robot's first half, and without any.

    Example: dslam benchmark live data --drive demo --drive greenhouse
    """
    from tempfile import TemporaryDirectory

    from slam.common.config import load_config
    from tools.lab.drives.ablation_drives import DRIVES
    from tools.lab.drives.live_drives import map_live

    config = load_config(config_file, settings or ())
    for name in drive or ():
        if name not in DRIVES:
            raise typer.BadParameter(f"there is no {name!r}; there are: {'; '.join(DRIVES)}.", param_hint="--drive")
    rows: list[dict[str, str]] = []
    for name in drive or DEFAULT_DRIVES:
        with TemporaryDirectory() as folder:
            runs = list(with_progress(map_live(DRIVES[name], data, config, Path(folder)), 4))
        rows += _rows(name, runs)
    report(rows, NOTE, texts=("mapped",), markdown=markdown, json={"rows": rows} if json else None)


def _rows(name: str, runs: Sequence[MappedDrive]) -> list[dict[str, str]]:
    from tools.lab.drives.live_drives import compare_with_replays

    rows = [{"drive": name, "mapped": run.name} for run in runs]
    for heading, key in COLUMNS.items():
        for row, run, ratio in zip(rows, runs, compare_with_replays(runs, key), strict=True):
            row[heading] = number(run.figure(key), 3) + ("" if ratio is None else f" ({ratio:.2f})")
    return rows
