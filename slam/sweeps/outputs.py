"""What a sweep leaves in its folder beside the cells: tables, a page and a picture."""

from __future__ import annotations

import json
from pathlib import Path

from slam.evaluation.sheets.files import write_sheets
from slam.sweeps.cells import write_text
from slam.sweeps.picture import draw_sweep
from slam.sweeps.sweep import Sweep
from slam.sweeps.table import sweep_sheets, to_markdown

JSON_NAME, TABLE_NAME, PICTURE_NAME = "sweep.json", "sweep.md", "sweep.png"
SHEET_NAMES = ("sweep.csv", "sweep.tex", "sweep.html")


def write_outputs(folder: Path, sweep: Sweep) -> None:
    """Write all of them.

    Raises:
        UnwritableLogError: one cannot be written.
    """
    write_text(folder / JSON_NAME, json.dumps(sweep.to_json_dict(), indent=2, allow_nan=False) + "\n")
    write_text(folder / TABLE_NAME, to_markdown(sweep))
    evaluations = {cell.name: result.evaluation for cell, result in sweep.results if result.evaluation is not None}
    for name in SHEET_NAMES:
        write_sheets(folder / name, f"{sweep.drive.path.stem}, degraded", sweep_sheets(sweep), evaluations)
    draw_sweep(folder / PICTURE_NAME, sweep)
