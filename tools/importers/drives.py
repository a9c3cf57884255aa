"""Writes an imported drive, and prints what was written."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from logs.importers.imported_log import DriveSummary, ImportedRecord


def write_drive(
    output: Path,
    records: Iterable[ImportedRecord],
    source: Mapping[str, str],
    *,
    json: bool,
    about: Mapping[str, Any] | None = None,
) -> None:
    """Write the log ``output`` and print a summary; ``about``: what a drive in text files is like."""
    from logs.importers.imported_log import write_imported_log

    summary = write_imported_log(output, records, source)
    show_written(output, summary, json=json, figures=about or {}, notes=_describe(about, summary) if about else ())


def show_written(
    output: Path,
    summary: DriveSummary,
    *,
    json: bool,
    figures: Mapping[str, Any],
    notes: Sequence[str] = (),
    title: str = "",
) -> None:
    """Print what was written; ``figures`` are added to the JSON, ``title`` and ``notes`` to the text."""
    from tools import console

    if json:
        console.show_json({"output": str(output), **asdict(summary), **figures})
        return
    console.show(
        f"{output}: {summary.duration_s:.0f} s{title}",
        console.pairs({f"  {topic}": f"{count} messages" for topic, count in summary.message_counts.items()}),
        f"  {summary.detection_count} objects detected",
        *notes,
    )


def _describe(about: Mapping[str, Any], summary: DriveSummary) -> list[str]:
    length_m = about["odometry_length_m"]
    speed = f" ({length_m / summary.duration_s:.2f} m/s)" if summary.duration_s > 0.0 else ""
    columns = about["columns_left_out"]
    return [
        f"  odometry in {about['odometry_format']} format, {length_m:.0f} m{speed}",
        *([f"  columns left out: {', '.join(columns)}"] if columns else []),
        *(f"  note: {note}" for note in about["notes"]),
    ]
