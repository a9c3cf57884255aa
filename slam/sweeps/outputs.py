"""What a sweep leaves in its folder beside the cells: sweep.json, sweep.md, sweep.png."""

from __future__ import annotations

import json
from pathlib import Path

from slam.sweeps.cells import write_text
from slam.sweeps.picture import draw_sweep
from slam.sweeps.sweep import Sweep
from slam.sweeps.table import to_markdown

JSON_NAME, TABLE_NAME, PICTURE_NAME = "sweep.json", "sweep.md", "sweep.png"


def write_outputs(folder: Path, sweep: Sweep) -> None:
    """Write all three.

    Raises:
        UnwritableLogError: one cannot be written.
    """
    write_text(folder / JSON_NAME, json.dumps(sweep.to_json_dict(), indent=2, allow_nan=False) + "\n")
    write_text(folder / TABLE_NAME, to_markdown(sweep))
    draw_sweep(folder / PICTURE_NAME, sweep)
