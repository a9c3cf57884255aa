"""Runs side by side: what is a group, and which differences are marked."""

from __future__ import annotations

import json
from functools import cache
from typing import Any

import numpy as np
import pytest
from scipy import stats

from slam.common.config import Config
from slam.common.config_tree import load_tree
from slam.common.errors import EvaluationError
from slam.evaluation.comparison import Comparison, Run, compare_runs
from slam.evaluation.metrics.statistics import Spread
from slam.evaluation.report.figures import HEADLINE_FIGURES, Figure

ATE = Figure("trajectory.ate_m", "ATE m", 3, is_error=True)


@cache
def configuration(*overrides: str) -> str:
    return load_tree(Config, None, overrides).model_dump_json()


def run(name: str, ate_m: float | None, *overrides: str, **made: str) -> Run:
    recorded = {"configuration": configuration(*overrides), "version": "1", **made}
    return Run(name, {"trajectory": {"ate_m": ate_m}}, recorded)


def runs(prefix: str, values: Any, *overrides: str) -> list[Run]:
    return [run(f"{prefix}{i}", float(value), *overrides) for i, value in enumerate(values)]


class TestSpread:
    def test_agrees_with_numpy(self) -> None:
        values = np.random.default_rng(0).normal(3.0, 2.0, 7)
        spread = Spread.over(values.tolist())
        assert spread.mean == pytest.approx(values.mean())
        assert spread.standard_deviation == pytest.approx(values.std(ddof=1))
        assert (spread.least, spread.greatest) == (values.min(), values.max())

    def test_undefined_values_are_left_out_and_counted(self) -> None:
        spread = Spread.over([1.0, None, 3.0])
        assert (spread.mean, spread.count, spread.run_count) == (2.0, 2, 3)
        assert spread.text(1) == "2.0 ± 1.4 (2 of 3)"

    def test_of_one_and_of_nothing(self) -> None:
        assert Spread.over([0.25]) == Spread(0.25, None, 1, 1, 0.25, 0.25)
        assert Spread.over([None]) == Spread(None, None, 0, 1, None, None)
        assert (Spread.over([0.25]).text(2), Spread.over([]).text(2)) == ("0.25", "–")

    def test_a_figure_that_is_not_there_is_undefined(self) -> None:
        for results in ({}, {"trajectory": None}, {"trajectory": {"ate_m": None}}, {"trajectory": {"ate_m": "4"}}):
            assert ATE.of(results) is None
        assert ATE.of({"trajectory": {"ate_m": 4}}) == 4.0


def groups_of(comparison: Comparison) -> dict[str, list[str]]:
    return {label: [each.name for each in runs] for label, runs in comparison.groups.items()}


class TestGroups:
    def test_groups_follow_configuration_in_order_of_runs(self) -> None:
        other = "loop_closure.descriptor=gosmatch_vertex"
        comparison = compare_runs([run("a", 1.0, other), run("b", 2.0), run("c", 3.0, other), run("d", 4.0)])
        assert groups_of(comparison) == {other: ["a", "c"], "defaults": ["b", "d"]}

    def test_label_is_what_differs(self) -> None:
        shared = "keyframe.distance_m=1.5"
        comparison = compare_runs([run("a", 1.0, shared, "loop_closure.top_k=15"), run("b", 1.0, shared)])
        assert list(comparison.groups) == ["loop_closure.top_k=15", "keyframe.distance_m=1.5"]

    def test_version_unknown_configuration_and_given_map_split_groups(self) -> None:
        unknown = [Run(name, {"trajectory": {"ate_m": 1.0}}, {}) for name in "xy"]
        given = [run("c", 1.0, map_drives="[1]"), run("d", 1.0, map_drives="[2]")]
        comparison = compare_runs([run("a", 1.0), run("b", 1.0, version="2"), *unknown, *given])
        assert list(groups_of(comparison).values()) == [["a"], ["b"], ["x"], ["y"], ["c"], ["d"]]
        assert list(comparison.groups)[:2] == ["version=1", "version=2"]

    def test_one_run_is_refused(self) -> None:
        with pytest.raises(EvaluationError, match="two or more"):
            compare_runs([run("a", 1.0)])


def marks(first: list[float], second: list[float | None]) -> dict[tuple[str, str], str]:
    others = [run(f"b{i}", value, "keyframe.distance_m=3.0") for i, value in enumerate(second)]
    return dict(compare_runs([*runs("a", first), *others]).marks)


@pytest.mark.parametrize(
    ("first", "second", "is_marked"),
    [
        ([1.0, 1.1, 0.9], [2.0, 2.1, 1.9], True),
        ([1.0, 2.0, 1.5], [2.0, 2.1, 1.9], False),  # within the spread
        ([1.0], [9.0], False),  # no spread to exceed
        ([1.0, 1.1, 0.9], [2.0], True),  # a single run, by the spread of the other group
        ([1.0, 1.1, 0.9], [1.3], False),
        ([0.3, 0.3], [0.1 + 0.2] * 2, False),  # rounding
        ([0.3, 0.3], [0.301] * 2, True),
        ([1.0, 1.0], [None, None], False),
    ],
)
def test_only_differences_beyond_the_spread_are_marked(
    first: list[float], second: list[float | None], is_marked: bool
) -> None:
    assert marks(first, second) == ({("keyframe.distance_m=3.0", ATE.key): "* worse"} if is_marked else {})


def test_limit_is_that_of_student() -> None:
    # Both groups have a deviation of 0.1; Student's t of 4 degrees of freedom exceeds 2 deviations.
    limit = 0.1 * stats.t.ppf(0.975, 4) * np.sqrt(2.0 / 3.0)
    for factor, is_marked in ((0.99, False), (1.01, True)):
        assert bool(marks([1.0, 1.1, 0.9], [1.0 + factor * limit + off for off in (0.0, 0.1, -0.1)])) == is_marked


def test_json_has_every_run_and_figure() -> None:
    comparison = compare_runs([*runs("a", [1.0, 1.1]), run("b", 9.0, "keyframe.distance_m=3.0")])
    told = json.loads(json.dumps(comparison.to_json_dict(), allow_nan=False))
    assert [(each["log"], each["group"]) for each in told["runs"]] == [
        ("a0", "defaults"), ("a1", "defaults"), ("b", "keyframe.distance_m=3.0")]  # fmt: skip
    assert set(told["groups"]["defaults"]) == {figure.key for figure in HEADLINE_FIGURES}
    assert [each["figure"] for each in told["marks"]] == ["trajectory.ate_m"]
    alone = compare_runs([run("a", 1.0), run("b", 9.0, "keyframe.distance_m=3.0")])
    assert "no difference is marked" in alone.to_json_dict()["note"]


def test_table_has_a_column_for_each_group_and_marks_differences() -> None:
    def marked_run(group: int, seed: int, ate_m: float, recall: float) -> Run:
        results = {"trajectory": {"ate_m": ate_m + 0.01 * seed}, "closures": {"recall": recall}}
        return Run(f"{group}{seed}", results, {"configuration": json.dumps({"keyframe": {"distance_m": group}})})

    numbers = {1: (1.0, 0.5), 2: (2.0, 0.9), 3: (1.02, 0.5)}
    several = [marked_run(group, seed, *pair) for group, pair in numbers.items() for seed in range(3)]
    table = compare_runs(several).to_table()
    assert all("(3 runs)" in heading for heading in table.columns)
    assert table.loc["ATE m"].tolist() == ["1.010 ± 0.010", "2.010 ± 0.010 * worse", "1.030 ± 0.010"]
    assert table.loc["closures recall"].tolist()[1] == "0.900 ± 0.000 * better"
