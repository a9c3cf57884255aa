"""The comparison of descriptors as files: CSV, a table for LaTeX with the best in bold, and a figure."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pandas as pd
from matplotlib.figure import Figure

from logs.storage.placement import write_text
from slam.display.map_picture import save_figure

CSV, LATEX, FIGURE = "descriptors.csv", "descriptors.tex", "descriptors.png"
_GRID = "#e5e7eb"
_ESCAPED = str.maketrans({"_": r"\_", "&": r"\&", "%": r"\%", "#": r"\#"})


def write_comparison(folder: Path, world: str, cells: pd.DataFrame, conditions: str) -> None:
    """Write the three files into a folder, which is made if it does not exist.

    Args:
        folder: of the files.
        world: name of the map.
        cells: as :func:`tools.lab.descriptors.experiment.benchmark_descriptors` returns them.
        conditions: how they were measured, for the caption.

    Raises:
        UnwritableLogError: a file cannot be written.
    """
    folder.mkdir(parents=True, exist_ok=True)
    write_text(folder / CSV, cells.to_csv(index=False, lineterminator="\n"))
    write_text(folder / LATEX, to_latex(cells, world, conditions))
    _draw(folder / FIGURE, cells)


def to_latex(cells: pd.DataFrame, world: str, conditions: str) -> str:
    """The success of each method by scenario, in per cent, the best of a scenario in bold, with caption and label."""
    success = 100.0 * cells.pivot(index="method", columns="scenario", values="success").astype(float)
    success = success.loc[cells["method"].unique(), cells["scenario"].unique()].round(1)
    texts = success.map(lambda share: f"{share:.1f}")
    texts = texts.where(success.lt(success.max(axis=0), axis=1), r"\textbf{" + texts + "}")
    texts.index = pd.Index([name.translate(_ESCAPED) for name in texts.index], name="descriptor")
    texts.columns.name = None
    caption = f"Localized queries [%] in {world}; {conditions}."
    return str(
        texts.reset_index().to_latex(
            index=False,
            escape=False,
            column_format="l" + "r" * texts.shape[1],
            caption=caption.translate(_ESCAPED),
            label=f"tab:descriptors-{world}",
        )
    )


def _draw(path_png: Path, cells: pd.DataFrame) -> None:
    """Bars of the success of each method by scenario; a line shows the ceiling."""
    methods, scenarios = cells["method"].unique(), cells["scenario"].unique()
    figure = Figure(figsize=(2.0 + 1.1 * len(methods), 4.0), layout="constrained", dpi=100)
    axes = figure.subplots()
    width = 0.8 / len(scenarios)
    for number, scenario in enumerate(scenarios):
        rows = cells[cells["scenario"] == scenario].set_index("method").loc[methods]
        places = np.arange(len(methods)) + width * (number - 0.5 * (len(scenarios) - 1))
        bars = axes.bar(places, 100.0 * rows["success"], width, yerr=100.0 * rows["deviation"], label=scenario)
        axes.hlines(
            100.0 * rows["ceiling"].iloc[0], -0.5, len(methods) - 0.5, bars[0].get_facecolor(), "dashed", linewidth=0.8
        )
    axes.set_xticks(range(len(methods)), list(methods), rotation=30, ha="right")
    axes.set_ylabel("success [%]; dashed: ceiling")
    axes.grid(axis="y", color=_GRID)
    axes.set_axisbelow(True)
    axes.spines[["top", "right"]].set_visible(False)
    figure.legend(loc="outside upper center", ncols=len(scenarios), frameon=False)
    save_figure(figure, path_png)
