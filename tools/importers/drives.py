"""Prints what was written of a drive."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from logs.importers.imported_log import DriveSummary


def show_written(
    output: Path,
    summary: DriveSummary,
    *,
    json: bool,
    figures: Mapping[str, Any] | None = None,
    notes: Sequence[str] = (),
    title: str = "",
) -> None:
    """Print what was written; ``figures`` are added to the JSON, ``title`` and ``notes`` to the text."""
    from tools import console

    if json:
        console.show_json({"output": str(output), **asdict(summary), **(figures or {})})
        return
    console.show(
        f"{output}: {summary.duration_s:.0f} s{title}",
        console.pairs({f"  {topic}": f"{count} messages" for topic, count in summary.message_counts.items()}),
        f"  {summary.detection_count} objects detected",
        *notes,
    )
