"""The files that a sweep writes beside its cells."""

from __future__ import annotations

import json
from pathlib import Path

import pandas as pd

from logs.storage.placement import write_text
from slam.evaluation.report.figures import HEADLINE_FIGURES
from slam.sweeps.sweep import Sweep, spread_over

NOTE = (
    "Mean ± standard deviation over the seeds. Precision, recall and opposite (recall over revisits in the opposite "
    "direction) are of accepted loop closures, associations the share of right ones, landmarks the share of objects in "
    "the map, x real time how fast the drive was mapped while the other cells were computed."
)
_CLOSURES = {"closures.precision": "precision", "closures.recall": "recall", "closures.recall_opposite": "opposite"}
_MAP = {
    "trajectory.ate_m": "ATE m",
    "trajectory.rpe_translation_percent": "RPE %",
    "associations.precision": "associations",
    "landmarks.recall": "landmarks",
}


def write_outputs(folder: Path, sweep: Sweep) -> list[Path]:
    """Write all of them; returns their paths.

    Raises:
        UnwritableLogError: one cannot be written.
    """
    texts = {
        "sweep.json": json.dumps(sweep.to_json_dict(), indent=2, allow_nan=False) + "\n",
        "sweep.md": to_markdown(sweep),
        "sweep.csv": pd.concat(make_tables(sweep).values(), axis=1).to_csv(lineterminator="\n"),
    }
    for name, text in texts.items():
        write_text(folder / name, text)
    return [folder / name for name in texts]


def make_tables(sweep: Sweep) -> dict[str, pd.DataFrame]:
    """Loop closures, trajectory and map, and what is reported, with a row for each degradation and variant."""
    closures, of_map, reported = dict[str, dict[str, str]](), dict[str, dict[str, str]](), dict[str, dict[str, str]]()
    for (variant, degradation), cells in sweep.rows().items():
        name = f"{degradation}: {variant}" if variant else degradation
        failed = int((cells["error"] != "").sum())
        runs = f"{len(cells)}" + (f", {failed} failed" if failed else "")
        closures[name] = {"runs": runs, **_figures(cells, _CLOSURES)}
        of_map[name] = {**_figures(cells, _MAP), "x real time": spread_over(cells, "real_time_factor").text(1)}
        reported[name] = {"reported": cells["reported"].iloc[0]}
    tables = {"loop closures": closures, "trajectory and map": of_map, "by the first seed": reported}
    return {title: pd.DataFrame(rows).T.rename_axis("degradation") for title, rows in tables.items()}


def to_markdown(sweep: Sweep) -> str:
    """The tables side by side, and what they were made from."""
    table = pd.concat(make_tables(sweep).values(), axis=1)
    headings = ["degradation", *table.columns]
    rows = [[str(name), *cells] for name, cells in zip(table.index, table.to_numpy().tolist(), strict=True)]
    lines = [
        f"# Degradations of {sweep.first.log.name}\n",
        f"dslam {sweep.first.version}, input SHA-256 {sweep.first.sha256}.\n",
        *(f"| {' | '.join(cell.replace('|', chr(92) + '|') for cell in row)} |"
          for row in (headings, ["---"] * len(headings), *rows)),
        f"\n{NOTE}",
        *(f"- failed: {failure}" for failure in sweep.failures),
    ]  # fmt: skip
    return "\n".join(lines) + "\n"


def _figures(cells: pd.DataFrame, headings: dict[str, str]) -> dict[str, str]:
    digits = {figure.key: min(figure.digits, 3) for figure in HEADLINE_FIGURES}
    return {heading: spread_over(cells, key).text(digits[key]) for key, heading in headings.items()}
