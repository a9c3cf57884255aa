"""dslam benchmark live."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from tools.arguments import ConfigFile, Json, Settings
from tools.lab.tables import Row, number, show, to_markdown

if TYPE_CHECKING:
    from tools.lab.live.live_runs import LiveRuns

DEFAULT_DRIVES = ("demo", "greenhouse", "lost_in_the_woods", "mrclam6/robot2", "wild03", "kitti00")
NOTE = """\
ATE in metres, aligned by SE(3): of the final trajectory, and online, of the poses as they were published; of whole
drives after the first fifth of the way. In brackets: by that of the replay above, which knows the whole log first."""


def live(
    data: Annotated[Path, typer.Argument(metavar="DATA", help="Folder with kitti00 and robots.", show_default=False)],
    drive: Annotated[list[str] | None, typer.Option(metavar="NAME", help="Only this drive. Repeatable.")] = None,
    output: Annotated[
        Path | None,
        typer.Option("-o", "--output", metavar="OUT.md", help="Write the table as Markdown.", show_default=False),
    ] = None,
    config_file: ConfigFile = None,
    settings: Settings = None,
    json: Json = False,
) -> None:
    """Map drives live and compare with replays: by a calibration of the robot's first half, and without any.

    Example: dslam benchmark live data --drive demo --drive greenhouse
    """
    from tempfile import TemporaryDirectory

    from logs.storage.placement import write_text
    from slam.common.config import load_config
    from tools import console
    from tools.lab.drives.ablation_drives import DRIVES
    from tools.lab.live.live_runs import run_live

    config = load_config(config_file, settings or ())
    for name in drive or ():
        if name not in DRIVES:
            raise typer.BadParameter(f"there is no {name!r}; there are: {'; '.join(DRIVES)}.", param_hint="--drive")
    found: list[LiveRuns] = []
    for name in drive or DEFAULT_DRIVES:
        with TemporaryDirectory() as folder:
            found.append(run_live(name, DRIVES[name], data, config, Path(folder)))
        for failure in found[-1].failures:
            typer.echo(f"{name}, {failure}", err=True)
        if output is not None:  # after each drive, for they may take hours
            write_text(output, f"{to_markdown(list(_rows(found)), texts=('mapped',))}\n\n{NOTE}\n")
    if json:
        console.show_json(
            {runs.name: dict(zip(("calibrated", "calibrated_online", "uncalibrated", "uncalibrated_online"),
                                 runs.ratios(), strict=True)) for runs in found}
        )  # fmt: skip
    elif output is None:
        show(list(_rows(found)), NOTE, texts=("mapped",))


def _rows(found: list[LiveRuns]) -> Iterator[Row]:
    from tools.lab.live.live_runs import rows_of

    for runs in found:
        final, online, final_uncalibrated, online_uncalibrated = runs.ratios()
        ratios = ((None, None), (final, online), (None, None), (final_uncalibrated, online_uncalibrated))
        for (mapped, run), (by_final, by_online) in zip(rows_of(runs), ratios, strict=True):
            yield {
                "drive": runs.name,
                "mapped": mapped,
                "ATE": _with_ratio(run.figure("trajectory.ate_m"), by_final),
                "online": _with_ratio(run.figure("trajectory.online_ate_m"), by_online),
            }


def _with_ratio(value: float | None, ratio: float | None) -> str:
    return number(value, 3) + ("" if ratio is None else f" ({ratio:.2f})")
