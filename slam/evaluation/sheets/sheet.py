"""A table as text: CSV, LaTeX."""

from __future__ import annotations

import csv
import io
from collections.abc import Sequence
from dataclasses import dataclass

from slam.evaluation.comparison import Comparison
from slam.evaluation.metrics.statistics import CHIEF_FIGURES, UNDEFINED

_LATEX = {
    **{each: f"\\{each}" for each in "&%$#_{}"},
    "\\": r"\textbackslash{}",
    "~": r"\textasciitilde{}",
    "^": r"\textasciicircum{}",
    "±": r"$\pm$",
    "–": "--",
}


@dataclass(frozen=True, slots=True)
class Sheet:
    """A table: ``headings`` of the columns, the first of which names the row; ``note`` says how to read it."""

    title: str
    headings: tuple[str, ...]
    rows: tuple[tuple[str, ...], ...]
    note: str = ""


def compare_sheet(comparison: Comparison) -> Sheet:
    """A row for each figure that is defined, a column for each group, or for each run where there is one group.

    ``*`` marks what differs from the first column by more than the spread.
    """
    groups = comparison.groups
    single = list(groups[0].runs) if len(groups) == 1 else []
    rows = []
    for figure in CHIEF_FIGURES:
        spreads = [group.spreads[figure.key] for group in groups]
        if all(spread.mean is None for spread in spreads):
            continue
        values = (figure.of(run.results) for run in single)
        cells = [UNDEFINED if value is None else f"{value:.{figure.digits}f}" for value in values]
        marks = [comparison.mark(figure.key, 0, number) is not None for number in range(len(groups))]
        cells += [s.text(figure.digits) + " *" * is_marked for s, is_marked in zip(spreads, marks, strict=True)]
        rows.append((figure.heading, *cells))
    headings = [run.name for run in single]
    headings += ["mean ± deviation"] if single else [f"{group.label} ({len(group.runs)} runs)" for group in groups]
    note = "Mean and standard deviation of the runs of one configuration; * differs from the first by more than chance."
    return Sheet("Runs side by side", ("", *headings), tuple(rows), note)


def to_csv(sheets: Sequence[Sheet]) -> str:
    """All of them below one another, with an empty line between."""
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    for number, sheet in enumerate(sheets):
        if number:
            writer.writerow([])
        writer.writerows([sheet.headings, *sheet.rows])
    return text.getvalue()


def to_latex(sheets: Sequence[Sheet]) -> str:
    r"""A ``tabular`` for each, with the rules of the package booktabs."""
    return "\n".join(_tabular(sheet) for sheet in sheets)


def _tabular(sheet: Sheet) -> str:
    columns = "l" + "r" * (len(sheet.headings) - 1)
    body = "\n".join(f"{_latex_row(row)}" for row in sheet.rows)
    return (
        f"% {sheet.title}. {sheet.note}\n\\begin{{tabular}}{{{columns}}}\n\\toprule\n{_latex_row(sheet.headings)}\n"
        f"\\midrule\n{body}\n\\bottomrule\n\\end{{tabular}}\n"
    )


def _latex_row(cells: Sequence[str]) -> str:
    return " & ".join("".join(_LATEX.get(c, c) for c in cell) for cell in cells) + r" \\"
