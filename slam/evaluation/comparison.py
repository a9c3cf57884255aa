"""Runs side by side: what differs between configurations by more than between repetitions of one."""

from __future__ import annotations

import json
import math
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from itertools import combinations
from pathlib import Path
from typing import Any

import pandas as pd
from scipy.special import stdtrit

from logs.container.json_text import parse_json
from slam.common.config import Config
from slam.common.config_tree import changes
from slam.common.errors import EvaluationError
from slam.evaluation.metrics.statistics import CONFIDENCE, Spread
from slam.evaluation.report.figures import HEADLINE_FIGURES, Figure

SPREAD_FACTOR = 2.0
RULE = (
    "Runs of one version with the same effective configuration are one group. A difference of the means of two groups "
    f"is marked where it exceeds {SPREAD_FACTOR:g} pooled standard deviations of the runs within all groups, and the "
    f"{100.0 * (1.0 - CONFIDENCE):.0f} % significance limit of one comparison (Student's t)."
)
NO_SPREAD = "No group has two runs, so the spread of the seeds is unknown and no difference is marked."

_ROUNDING = 1e-9  # relative; what two ways of adding up the same numbers may differ by


@dataclass(frozen=True, slots=True)
class Run:
    """The evaluation of one log: its JSON in ``results``.

    ``configuration``: the effective one, JSON as the log recorded it; "" where it did not. ``given_map``: the map that
    the drive was given, and whether it went on from it; "" without one.
    """

    name: str
    results: Mapping[str, Any]
    configuration: str = ""
    version: str = ""
    input_sha256: str = ""
    given_map: str = ""


@dataclass(frozen=True, slots=True)
class Group:
    """Runs of one configuration; ``changes`` is what it has otherwise than the defaults, "key=value" each.

    ``spreads``: by the key of the figure.
    """

    label: str
    runs: tuple[Run, ...]
    changes: tuple[str, ...]
    spreads: Mapping[str, Spread]

    @property
    def descriptor(self) -> str:
        """That of the configuration; "" where the log does not tell."""
        try:
            return str(parse_json(self.runs[0].configuration)["loop_closure"]["descriptor"])
        except (ValueError, KeyError, TypeError):
            return ""

    @property
    def closure_means(self) -> dict[str, float]:
        """Means of the figures of closures that are defined."""
        return {key: each.mean for key, each in self.spreads.items() if "closures." in key and each.mean is not None}


@dataclass(frozen=True, slots=True)
class Difference:
    """The mean of ``second`` less that of ``first`` (numbers of groups) exceeds ``threshold``."""

    key: str
    first: int
    second: int
    difference: float
    threshold: float


@dataclass(frozen=True, slots=True)
class Comparison:
    """Groups in the order of their first runs, and the differences that exceed the spread within them."""

    groups: tuple[Group, ...]
    marked: tuple[Difference, ...]

    @property
    def has_spread(self) -> bool:
        """Whether any group has the two runs without which nothing can be marked."""
        return any(len(group.runs) > 1 for group in self.groups)

    def to_table(self) -> pd.DataFrame:
        """A row for each figure that is defined, a column for each group, or for each run where there is one group.

        A mark says whether a group is better or worse than the first by more than the spread.
        """
        defined = [f for f in HEADLINE_FIGURES if any(group.spreads[f.key].mean is not None for group in self.groups)]
        is_one_group = len(self.groups) == 1
        runs = self.groups[0].runs if is_one_group else ()
        is_stem_unique = len({Path(run.name).stem for run in runs}) == len(runs)
        columns = {
            Path(run.name).stem if is_stem_unique else run.name: [
                Spread.over([figure.of(run.results)]).text(figure.digits) for figure in defined
            ]
            for run in runs
        }
        for number, group in enumerate(self.groups):
            name = "mean ± deviation" if is_one_group else f"{group.label} ({len(group.runs)} runs)"
            columns[name] = [group.spreads[f.key].text(f.digits) + self._mark(f, number) for f in defined]
        return pd.DataFrame(columns, index=[figure.heading for figure in defined])

    @property
    def descriptor_verdict(self) -> str:
        """Which groups have the closures of the first with another descriptor; "" where none has."""
        first, *others = self.groups
        means = first.closure_means
        alike = [
            group.label
            for group in others
            if group.descriptor != first.descriptor and means.items() <= group.closure_means.items()
        ]
        if not alike or not means:
            return ""
        return f"The descriptor decided nothing: {first.label} and {', '.join(alike)} have the same closures."

    def _mark(self, figure: Figure, number: int) -> str:
        """How the group differs from the first in that figure; "" where it does not."""
        found = [each for each in self.marked if (each.key, each.first, each.second) == (figure.key, 0, number)]
        if not found:
            return ""
        return " * better" if (found[0].difference < 0.0) == figure.is_error else " * worse"

    def to_json_dict(self) -> dict[str, Any]:
        """Plain dicts, lists, strings and finite numbers; groups are numbered as in the list."""
        return {
            "runs": [
                {
                    "log": run.name,
                    "group": number,
                    "version": run.version,
                    "input_sha256": run.input_sha256,
                    "evaluation": dict(run.results),
                }
                for number, group in enumerate(self.groups)
                for run in group.runs
            ],
            "groups": [
                {
                    "label": group.label,
                    "changes": list(group.changes),
                    "runs": [run.name for run in group.runs],
                    "figures": {key: asdict(spread) for key, spread in group.spreads.items()},
                }
                for group in self.groups
            ],
            "marked_differences": [asdict(difference) for difference in self.marked],
            "rule": RULE,
            "note": "" if self.has_spread else NO_SPREAD,
        }


def compare_runs(runs: Sequence[Run], figures: Sequence[Figure] = HEADLINE_FIGURES) -> Comparison:
    """Group the runs by their configurations and mark what differs between the groups by more than ``RULE`` says.

    Raises:
        EvaluationError: fewer than two runs.
    """
    if len(runs) < 2:
        raise EvaluationError(f"{len(runs)} run cannot be compared; give two or more")
    members: dict[str, list[Run]] = {}
    for run in runs:
        members.setdefault(_identity(run), []).append(run)
    described = [_changes(group[0]) for group in members.values()]
    groups = tuple(
        Group(
            label=label,
            runs=tuple(group),
            changes=tuple(own),
            spreads={figure.key: Spread.over(figure.of(run.results) for run in group) for figure in figures},
        )
        for group, own, label in zip(members.values(), described, _labels(described), strict=True)
    )
    return Comparison(groups, tuple(d for figure in figures for d in _differences(groups, figure.key)))


def _differences(groups: Sequence[Group], key: str) -> list[Difference]:
    """The marked differences of one figure."""
    spreads = [group.spreads[key] for group in groups]
    freedom = sum(spread.count - 1 for spread in spreads if spread.count > 1)
    if freedom == 0:
        return []
    squares = math.fsum((s.count - 1) * s.standard_deviation**2 for s in spreads if s.standard_deviation is not None)
    pooled = math.sqrt(squares / freedom)
    student = float(stdtrit(freedom, 0.5 + 0.5 * CONFIDENCE))
    found = []
    for (i, first), (j, second) in combinations(enumerate(spreads), 2):
        if first.mean is None or second.mean is None:
            continue
        threshold = pooled * max(SPREAD_FACTOR, student * math.sqrt(1.0 / first.count + 1.0 / second.count))
        difference = second.mean - first.mean
        if abs(difference) > threshold + _ROUNDING * max(abs(first.mean), abs(second.mean)):
            found.append(Difference(key, i, j, difference, threshold))
    return found


def _identity(run: Run) -> str:
    """Equal for runs that are repetitions of one another; a run without provenance equals no other."""
    try:
        configuration = json.dumps(parse_json(run.configuration), sort_keys=True)
    except ValueError:
        return f"unknown {run.name}"
    return f"{run.version} {run.given_map} {configuration}"


def _changes(run: Run) -> list[str]:
    if not run.configuration:
        return [f"unknown configuration of {run.name}"]
    return (
        [change.replace('"', "") for change in changes(Config(), run.configuration)]
        + ([f"version={run.version}"] if run.version else [])
        + (["given map"] if run.given_map else [])
    )


def _labels(described: Sequence[Sequence[str]]) -> list[str]:
    """For each group what it has otherwise than the others, else than the defaults."""
    counts = Counter(change for own in described for change in own)
    labels: list[str] = []
    for own in described:
        changed = [change for change in own if not change.startswith("version=")]
        label = ", ".join([change for change in own if counts[change] < len(described)] or changed) or "defaults"
        labels.append(label if label not in labels else f"{label} ({len(labels) + 1})")
    return labels
