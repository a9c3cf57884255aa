"""dslam evaluate --sweep: one drive under many degradations."""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from pathlib import Path

from tools.evaluation.output import Findings

DEFAULT_SEEDS = 3


def sweep_drive(
    source: Path,
    folder: Path,
    *,
    degradations: Sequence[str],
    seeds: int | None,
    jobs: int | None,
    config_file: Path | None,
    settings: Sequence[str],
    topics: Mapping[str, str],
) -> Findings:
    """Compute what is missing of the sweep, and leave tables and picture in its folder.

    Raises:
        LogError, SlamError: the input, a degradation, a setting or the folder cannot be used.
    """
    from slam.common.config import load_config
    from slam.sweeps.degradations import parse_degradations
    from slam.sweeps.outputs import JSON_NAME, PICTURE_NAME, TABLE_NAME, write_outputs
    from slam.sweeps.sweep import run_sweep
    from slam.sweeps.table import NOTE, closure_table, map_table
    from tools import console

    wanted = parse_degradations(degradations)
    config = load_config(config_file, settings)
    with console.progress_bar("sweeping", "drawing") as progress:
        sweep = run_sweep(
            source,
            folder,
            wanted,
            config,
            seeds=DEFAULT_SEEDS if seeds is None else seeds,
            jobs=jobs or os.cpu_count() or 1,
            topics=topics,
            on_progress=progress,
        )
        write_outputs(folder, sweep)
    tables = []
    for title, (headings, *rows) in {
        "Loop closures": closure_table(sweep),
        "Trajectory and map": map_table(sweep),
    }.items():
        tables.append(console.grid({heading: index > 0 for index, heading in enumerate(headings)}, title=f"\n{title}"))
        for row in rows:
            tables[-1].add_row(*row)
    reused = len(sweep.results) - sweep.computed
    return Findings(
        results=sweep.to_json_dict(),
        parts=[
            *tables,
            NOTE,
            f"{sweep.computed} cells computed in {sweep.wall_s:.0f} s, {reused} were there before",
            f"written: {', '.join(str(folder / name) for name in (JSON_NAME, TABLE_NAME, PICTURE_NAME))}",
        ],
        runs={
            f"{cell.degradation.name}, seed {cell.seed}": result.evaluation
            for cell, result in sweep.results
            if result.evaluation is not None
        },
        failures=sweep.failures,
    )
