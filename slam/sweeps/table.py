"""A sweep as tables: their headings and cells, and all in one in Markdown."""

from __future__ import annotations

from collections.abc import Iterable, Sequence

from slam.evaluation.metrics.statistics import CHIEF_FIGURES
from slam.evaluation.sheets.sheet import Sheet
from slam.sweeps.sweep import Sweep, SweepRow

_CLOSURES = {"closures.precision": "precision", "closures.recall": "recall", "closures.recall_opposite": "opposite"}
_MAP = {
    "trajectory.ate_m": "ATE m",
    "trajectory.rpe_translation_percent": "RPE %",
    "associations.precision": "associations",
    "landmarks.recall": "landmarks",
}
_SPEED = "x real time"
NOTE = (
    "Mean ± standard deviation over the seeds. Precision, recall and opposite (recall over revisits in the opposite "
    "direction) are of accepted loop closures, associations the share of right ones, landmarks the share of objects in "
    "the map, x real time how fast the drive was mapped while the other cells were computed."
)


def closure_table(sweep: Sweep) -> list[list[str]]:
    """Headings, then a row for each degradation."""
    return [
        ["degradation", "runs", *_CLOSURES.values()],
        *([_name(row), _runs(row), *_figures(row, _CLOSURES)] for row in sweep.rows),
    ]


def map_table(sweep: Sweep) -> list[list[str]]:
    """Headings, then a row for each degradation."""
    return [
        ["degradation", *_MAP.values(), _SPEED],
        *([_name(row), *_figures(row, _MAP), row.real_time_factor.text(1)] for row in sweep.rows),
    ]


def sweep_sheets(sweep: Sweep) -> list[Sheet]:
    """Both tables, for files."""
    tables = {"Loop closures": closure_table(sweep), "Trajectory and map": map_table(sweep)}
    return [
        Sheet(title, tuple(headings), tuple(tuple(row) for row in rows), NOTE)
        for title, (headings, *rows) in tables.items()
    ]


def to_markdown(sweep: Sweep) -> str:
    """The table, and from what it was made."""
    drive = sweep.drive
    table = [closures + of_map[1:] for closures, of_map in zip(closure_table(sweep), map_table(sweep), strict=True)]
    lines = [
        f"# Degradations of {drive.path.name}",
        "",
        f"dslam {drive.version}, input SHA-256 {drive.sha256}.",
        "",
        _line(table[0]),
        _line(["---"] * len(table[0])),
        *(_line(row) for row in table[1:]),
        "",
        NOTE,
    ]
    lines += ["", *(f"- failed: {failure}" for failure in sweep.failures)] if sweep.failures else []
    return "\n".join(lines) + "\n"


def _name(row: SweepRow) -> str:
    return f"{row.degradation.name}: {row.variant}" if row.variant else row.degradation.name


def _line(cells: Sequence[str]) -> str:
    return f"| {' | '.join(cell.replace('|', chr(92) + '|') for cell in cells)} |"


def _figures(row: SweepRow, shown: Iterable[str]) -> list[str]:
    digits = {figure.key: min(figure.digits, 3) for figure in CHIEF_FIGURES}
    spreads = row.spreads
    return [spreads[key].text(digits[key]) for key in shown]


def _runs(row: SweepRow) -> str:
    count, failed = len(row.results), sum(bool(result.error) for _, result in row.results)
    return f"{count}" if not failed else f"{count}, {failed} failed"
