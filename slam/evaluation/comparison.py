"""Comparison of runs: differences between configurations that exceed those between repetitions."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from hashlib import sha256
from typing import Any

import numpy as np
import pandas as pd
from scipy.special import stdtrit

from slam.common.config import Config
from slam.common.config_tree import changes
from slam.common.errors import EvaluationError
from slam.evaluation.metrics.statistics import CONFIDENCE, Spread
from slam.evaluation.report.figures import HEADLINE_FIGURES, Figure

SPREAD_FACTOR = 2.0
RULE = (
    "Runs of one version with the same effective configuration are one group. A group is marked where its mean differs "
    f"from that of the first group by more than {SPREAD_FACTOR:g} pooled standard deviations of the runs within all "
    f"groups, and by more than the {100.0 * (1.0 - CONFIDENCE):.0f} % significance limit of one comparison (Student's "
    "t)."
)
NO_SPREAD = "No group has two runs, so the spread of the seeds is unknown and no difference is marked."

_ROUNDING = 1e-9  # relative; what two ways of adding up the same numbers may differ by


@dataclass(frozen=True, slots=True)
class Run:
    """The evaluation of one log: its JSON in ``results``, and what the log recorded of how it was ``made``."""

    name: str
    results: Mapping[str, Any]
    made: Mapping[str, str]


@dataclass(frozen=True, slots=True, eq=False)
class Comparison:
    """Runs by the label of their group, in the order of the first runs, and marks.

    ``marks``: "* better" or "* worse" by group and key of the figure, where the group differs from the first one by
    more than the spread.
    """

    groups: Mapping[str, Sequence[Run]]
    marks: Mapping[tuple[str, str], str]

    @property
    def note(self) -> str:
        """How differences are marked, or why none is."""
        return RULE if any(len(runs) > 1 for runs in self.groups.values()) else NO_SPREAD

    def to_table(self) -> pd.DataFrame:
        """A row for each figure that is defined, a column for each group: mean, deviation and mark."""
        every = [run for runs in self.groups.values() for run in runs]
        defined = [figure for figure in HEADLINE_FIGURES if spread_of(figure, every).count]
        columns = {
            f"{label} ({len(runs)} runs)": [
                f"{spread_of(figure, runs).text(figure.digits)} {self.marks.get((label, figure.key), '')}".strip()
                for figure in defined
            ]
            for label, runs in self.groups.items()
        }
        return pd.DataFrame(columns, index=[figure.heading for figure in defined])

    def to_json_dict(self) -> dict[str, Any]:
        """Plain dicts, lists, strings and finite numbers."""
        return {
            "runs": [
                {
                    "log": run.name,
                    "group": label,
                    "version": run.made.get("version", ""),
                    "input_sha256": run.made.get("input_sha256", ""),
                    "evaluation": dict(run.results),
                }
                for label, runs in self.groups.items()
                for run in runs
            ],
            "groups": {
                label: {figure.key: asdict(spread_of(figure, runs)) for figure in HEADLINE_FIGURES}
                for label, runs in self.groups.items()
            },
            "marks": [{"group": label, "figure": key, "mark": mark} for (label, key), mark in self.marks.items()],
            "note": self.note,
        }


def spread_of(figure: Figure, runs: Sequence[Run]) -> Spread:
    """Mean and deviation of a figure over runs."""
    return Spread.over(figure.of(run.results) for run in runs)


def compare_runs(runs: Sequence[Run]) -> Comparison:
    """Group the runs by their configurations and mark what differs from the first group by more than ``RULE`` says.

    Raises:
        EvaluationError: fewer than two runs.
    """
    if len(runs) < 2:
        raise EvaluationError(f"{len(runs)} run cannot be compared; give two or more")
    groups: dict[str, list[Run]] = {}
    for run, label in zip(runs, _labels(runs), strict=True):
        groups.setdefault(label, []).append(run)
    marks = {}
    for figure in HEADLINE_FIGURES:
        for label in _find_different(groups, figure):
            first, own = (spread_of(figure, each).mean or 0.0 for each in (next(iter(groups.values())), groups[label]))
            marks[label, figure.key] = "* better" if (own < first) == figure.is_error else "* worse"
    return Comparison(groups, marks)


def _find_different(groups: Mapping[str, Sequence[Run]], figure: Figure) -> list[str]:
    """Labels of the groups whose mean differs from that of the first group by more than chance makes."""
    labels = [label for label, runs in groups.items() for _ in runs]
    values = [figure.of(run.results) for runs in groups.values() for run in runs]
    by_group = pd.Series(values, index=labels, dtype=float).groupby(level=0, sort=False)
    mean, count = by_group.mean(), by_group.count()
    freedom = (count - 1).clip(lower=0).sum()
    pooled = np.sqrt((by_group.var() * (count - 1)).sum() / freedom) if freedom else np.inf
    student = stdtrit(freedom, 0.5 + 0.5 * CONFIDENCE) * np.sqrt(1.0 / count + (1.0 / count).iloc[0])
    rounding = _ROUNDING * np.maximum(mean.abs(), abs(mean.iloc[0]))
    is_different = (mean - mean.iloc[0]).abs() > pooled * np.maximum(SPREAD_FACTOR, student) + rounding
    return list(mean.index[is_different])


def _labels(runs: Sequence[Run]) -> list[str]:
    """The settings of each run that differ from those of the other runs, else from the defaults."""
    described = [_changes(run) for run in runs]
    shared = set(described[0]).intersection(*described)
    return [", ".join([change for change in own if change not in shared] or own[1:]) or "defaults" for own in described]


def _changes(run: Run) -> list[str]:
    """The version, and the settings that differ from the defaults, "key=value" each."""
    configuration, version = run.made.get("configuration", ""), f"version={run.made.get('version', '')}"
    if not configuration:
        return [version, f"unknown configuration of {run.name}"]
    given_map = run.made.get("map_drives", "") + run.made.get("map_extended", "")
    given = [f"given map {sha256(given_map.encode()).hexdigest()[:8]}"] if given_map else []
    return [version, *(each.replace('"', "") for each in changes(Config(), configuration)), *given]
