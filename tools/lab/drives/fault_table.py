"""The table of a benchmark of faults, as Markdown."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from tools.lab.drives.fault_runs import FaultRun

HEADINGS = (
    "fault",
    "ATE m",
    "odometry ATE m",
    "closures accepted",
    "precision",
    "false in the graph",
    "landmarks",
    "reported",
    "s",
)


def table_row(run: FaultRun, reported: str) -> tuple[str, ...]:
    """The cells of a run under :data:`HEADINGS`; ``reported`` is what 'dslam replay' prints of it."""
    return (
        run.fault,
        _decimal(run.ate_m, 3),
        _decimal(run.odometry_ate_m, 3),
        _whole(run.closures_accepted),
        _decimal(run.precision, 3),
        _whole(run.false_closures_in_graph),
        _whole(run.landmarks),
        f"error: {run.error}" if run.error else reported,
        _decimal(run.seconds, 0),
    )


def render_markdown(log: Path, seed: int, rows: Sequence[Sequence[str]]) -> str:
    """The rows under a heading with the name of the drive."""
    lines = [
        f"# Faults of the input of {log.name}, seed {seed}",
        "",
        _line(HEADINGS),
        _line(["---", *["---:"] * 6, "---", "---:"]),
        *(_line([cell.replace("|", "\\|").replace("\n", " ") for cell in row]) for row in rows),
    ]
    return "\n".join(lines) + "\n"


def _line(cells: Sequence[str]) -> str:
    return f"| {' | '.join(cells)} |"


def _decimal(value: float | None, digits: int) -> str:
    return "–" if value is None else f"{value:.{digits}f}"


def _whole(value: int | None) -> str:
    return "–" if value is None else str(value)
