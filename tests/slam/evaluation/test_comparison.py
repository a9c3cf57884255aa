"""Runs side by side: what is a group, and which differences are marked."""

from __future__ import annotations

import json
from dataclasses import replace
from functools import cache
from typing import Any

import numpy as np
import pytest
from scipy import stats

from slam.common.config import Config
from slam.common.config_tree import load_tree
from slam.common.errors import EvaluationError
from slam.evaluation.comparison import Run, compare_runs
from slam.evaluation.metrics.statistics import Spread
from slam.evaluation.report.figures import HEADLINE_FIGURES, Figure

ATE = Figure("trajectory.ate_m", "ATE m", 3, is_error=True)


@cache
def configuration(*overrides: str) -> str:
    return load_tree(Config, None, overrides).model_dump_json()


def run(name: str, ate_m: float | None, *overrides: str, version: str = "1") -> Run:
    return Run(name, {"trajectory": {"ate_m": ate_m}}, configuration(*overrides), version)


def runs(prefix: str, values: Any, *overrides: str) -> list[Run]:
    return [run(f"{prefix}{i}", float(value), *overrides) for i, value in enumerate(values)]


class TestSpread:
    def test_agrees_with_numpy(self) -> None:
        values = np.random.default_rng(0).normal(3.0, 2.0, 7)
        spread = Spread.over(values.tolist())
        assert spread.mean == pytest.approx(values.mean())
        assert spread.standard_deviation == pytest.approx(values.std(ddof=1))

    def test_undefined_values_are_left_out_and_counted(self) -> None:
        spread = Spread.over([1.0, None, 3.0])
        assert (spread.mean, spread.count, spread.run_count) == (2.0, 2, 3)
        assert spread.text(1) == "2.0 ± 1.4 (2 of 3)"

    def test_of_one_and_of_nothing(self) -> None:
        assert Spread.over([0.25]) == Spread(0.25, None, 1, 1)
        assert Spread.over([None]) == Spread(None, None, 0, 1)
        assert (Spread.over([0.25]).text(2), Spread.over([]).text(2)) == ("0.25", "–")

    def test_equal_values_have_none(self) -> None:
        assert Spread.over([0.1] * 3).standard_deviation == 0.0

    def test_a_figure_that_is_not_there_is_undefined(self) -> None:
        for results in ({}, {"trajectory": None}, {"trajectory": {"ate_m": None}}, {"trajectory": {"ate_m": "4"}}):
            assert ATE.of(results) is None
        assert ATE.of({"trajectory": {"ate_m": 4}}) == 4.0


class TestGroups:
    def test_groups_follow_configuration_in_order_of_runs(self) -> None:
        other = "loop_closure.descriptor=gosmatch_vertex"
        comparison = compare_runs([run("a", 1.0, other), run("b", 2.0), run("c", 3.0, other), run("d", 4.0)], [ATE])
        assert [[each.name for each in group.runs] for group in comparison.groups] == [["a", "c"], ["b", "d"]]
        assert [group.label for group in comparison.groups] == [other, "defaults"]
        assert [group.spreads[ATE.key].mean for group in comparison.groups] == [2.0, 3.0]

    def test_the_label_is_what_differs(self) -> None:
        shared = "keyframe.distance_m=1.5"
        comparison = compare_runs([run("a", 1.0, shared, "loop_closure.top_k=15"), run("b", 1.0, shared)], [ATE])
        assert [group.label for group in comparison.groups] == ["loop_closure.top_k=15", "keyframe.distance_m=1.5"]

    def test_the_order_of_keys_is_none_of_the_configuration(self) -> None:
        first = run("a", 1.0)
        turned = json.dumps(dict(reversed(json.loads(first.configuration).items())))
        assert len(compare_runs([first, Run("b", first.results, turned, "1")], [ATE]).groups) == 1

    def test_version_and_unknown_configuration_split_groups(self) -> None:
        unknown = Run("x", {"trajectory": {"ate_m": 1.0}})
        other_unknown = Run("y", {"trajectory": {"ate_m": 1.0}})
        comparison = compare_runs([run("a", 1.0), run("b", 1.0, version="2"), unknown, other_unknown], [ATE])
        labels = [group.label for group in comparison.groups]
        assert labels == ["version=1", "version=2", "unknown configuration of x", "unknown configuration of y"]

    def test_one_run_is_refused(self) -> None:
        with pytest.raises(EvaluationError, match="two or more"):
            compare_runs([run("a", 1.0)])


class TestMarks:
    def test_a_real_difference(self) -> None:
        groups = [*runs("a", [1.0, 1.1, 0.9]), *runs("b", [2.0, 2.1, 1.9], "keyframe.distance_m=3.0")]
        (marked,) = compare_runs(groups, [ATE]).marked
        assert (marked.key, marked.first, marked.second) == (ATE.key, 0, 1)
        assert marked.difference == pytest.approx(1.0)
        # Both groups have a deviation of 0.1; Student's t of 4 degrees of freedom exceeds 2 deviations.
        assert marked.threshold == pytest.approx(0.1 * stats.t.ppf(0.975, 4) * np.sqrt(2.0 / 3.0))

    def test_not_a_difference_within_the_spread(self) -> None:
        groups = [*runs("a", [1.0, 2.0, 1.5]), *runs("b", [2.0, 2.1, 1.9], "keyframe.distance_m=3.0")]
        assert compare_runs(groups, [ATE]).marked == ()

    def test_single_runs_have_no_spread_to_exceed(self) -> None:
        comparison = compare_runs([run("a", 1.0), run("b", 9.0, "keyframe.distance_m=3.0")], [ATE])
        assert comparison.marked == ()
        assert not comparison.has_spread
        assert "no difference is marked" in comparison.to_json_dict()["note"]

    def test_single_run_is_compared_by_spread_of_other_groups(self) -> None:
        far, near = (
            compare_runs([*runs("a", [1.0, 1.1, 0.9]), run("b", value, "keyframe.distance_m=3.0")], [ATE]).marked
            for value in (2.0, 1.3)
        )
        assert (len(far), len(near)) == (1, 0)

    def test_equal_seeds_mark_differences_beyond_rounding(self) -> None:
        def marked(value: float) -> int:
            second = runs("b", [value] * 2, "keyframe.distance_m=3.0")
            return len(compare_runs([*runs("a", [0.3, 0.3]), *second], [ATE]).marked)

        assert (marked(0.1 + 0.2), marked(0.301)) == (0, 1)

    def test_what_is_undefined_differs_from_nothing(self) -> None:
        undefined = [run(f"b{i}", None, "keyframe.distance_m=3.0") for i in range(2)]
        assert compare_runs([*runs("a", [1.0, 1.0]), *undefined], [ATE]).marked == ()


def test_json_has_every_run_and_figure() -> None:
    comparison = compare_runs([*runs("a", [1.0, 1.1]), run("b", 9.0, "keyframe.distance_m=3.0")])
    told = json.loads(json.dumps(comparison.to_json_dict(), allow_nan=False))
    assert [each["log"] for each in told["runs"]] == ["a0", "a1", "b"]
    assert [each["group"] for each in told["runs"]] == [0, 0, 1]
    assert set(told["groups"][0]["figures"]) == {figure.key for figure in HEADLINE_FIGURES}
    assert told["groups"][1]["changes"] == ["keyframe.distance_m=3.0", "version=1"]
    assert [each["key"] for each in told["marked_differences"]] == ["trajectory.ate_m"]


def test_runs_with_different_given_maps_are_different_groups() -> None:
    given = [replace(run(name, 1.0), given_map=given_map) for name, given_map in (("c", "[1]true"), ("d", "[1]false"))]
    compared = compare_runs([run("a", 1.0), run("b", 2.0), *given])
    assert [len(group.runs) for group in compared.groups] == [2, 1, 1]


def test_table_has_a_column_for_each_group_and_marks_differences() -> None:
    def marked_run(group: int, seed: int, ate_m: float, recall: float) -> Run:
        results = {"trajectory": {"ate_m": ate_m + 0.01 * seed}, "closures": {"recall": recall}}
        return Run(f"{group}{seed}", results, json.dumps({"keyframe": {"distance_m": group}}), "1")

    numbers = {1: (1.0, 0.5), 2: (2.0, 0.9), 3: (1.02, 0.5)}
    several = [marked_run(group, seed, *pair) for group, pair in numbers.items() for seed in range(3)]
    table = compare_runs(several).to_table()
    assert all("(3 runs)" in heading for heading in table.columns)
    assert table.loc["ATE m"].tolist() == ["1.010 ± 0.010", "2.010 ± 0.010 * worse", "1.030 ± 0.010"]
    assert table.loc["closures recall"].tolist()[1] == "0.900 ± 0.000 * better"
    alone = compare_runs(several[:3]).to_table()
    assert list(alone.columns) == ["10", "11", "12", "mean ± deviation"]
    assert alone.loc["ATE m"].tolist()[:3] == ["1.000", "1.010", "1.020"]


class TestDescriptorVerdict:
    CLOSURES = Figure("closures.recall", "recall", 3, is_error=False)

    def verdict(self, recall: float, *overrides: str) -> str:
        first = Run("a", {"closures": {"recall": 0.9}}, configuration(), "1")
        other = Run("b", {"closures": {"recall": recall}}, configuration(*overrides), "1")
        return compare_runs([first, other], [self.CLOSURES]).descriptor_verdict

    @pytest.mark.parametrize(
        ("recall", "override", "verdict"),
        [
            (0.9, "loop_closure.descriptor=random", "The descriptor decided nothing: "),
            (0.8, "loop_closure.descriptor=random", ""),
            (0.9, "loop_closure.top_k=15", ""),
        ],
    )
    def test_says_that_another_descriptor_has_the_same_closures(
        self, recall: float, override: str, verdict: str
    ) -> None:
        found = self.verdict(recall, override)
        assert found.startswith(verdict)
        assert bool(found) == bool(verdict)

    @pytest.mark.parametrize("damaged", ["", "{", "[]", "{}"])
    def test_is_silent_about_unreadable_configuration(self, damaged: str) -> None:
        results = {"closures": {"recall": 0.9}}
        runs = [Run(name, results, text) for name, text in (("a", damaged), ("b", damaged), ("c", ""))]
        assert compare_runs(runs, [self.CLOSURES]).descriptor_verdict == ""
