"""Writes an imported drive, and prints what was written."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from logs.importers.imported_log import ImportedRecord


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
    from tools import console

    summary = write_imported_log(output, records, source)
    if json:
        console.show_json(
            {
                "output": str(output),
                "duration_s": summary.duration_s,
                "detection_count": summary.detection_count,
                "message_counts": summary.message_counts,
                **(about or {}),
            }
        )
        return
    console.show(
        f"{output}: {summary.duration_s:.0f} s",
        console.pairs({f"  {topic}": f"{count} messages" for topic, count in summary.message_counts.items()}),
        f"  {summary.detection_count} objects detected",
        *(_describe(about, summary.duration_s) if about else ()),
    )


def _describe(about: Mapping[str, Any], duration_s: float) -> list[str]:
    length_m = about["odometry_length_m"]
    speed = f" ({length_m / duration_s:.2f} m/s)" if duration_s > 0.0 else ""
    columns = about["columns_left_out"]
    return [
        f"  odometry in {about['odometry_format']} format, {length_m:.0f} m{speed}",
        *([f"  columns left out: {', '.join(columns)}"] if columns else []),
        *(f"  note: {note}" for note in about["notes"]),
    ]
