"""Sentences and tables around the figures of an evaluation."""

import re

import pytest

from logs.messages import StatusRecord
from slam.evaluation.evaluate import evaluate
from slam.evaluation.inputs.records import EvaluationRecords
from slam.evaluation.report.figures import SUMMARY, fill, summarize, value_at
from tests.slam.evaluation.results import measured
from tests.slam.evaluation.test_evaluate import MADE

RESULTS = {"a": {"error_m": 0.25, "share": 0.5, "count": 3, "none": None}, "text": "x"}


@pytest.mark.parametrize(
    ("clauses", "expected"),
    [
        (("error {a[error_m]:.3f} m", ", {a[count]:d} found"), "error 0.250 m, 3 found"),
        (("error {a[none]:.3f} m", ", {a[share]:.2%} right"), "50.00 % right"),
        (("{a[none]:s}", " (in parentheses)"), ""),
        (("{a[missing][deeper]:d}",), ""),
        (("{a[none][deeper]:d}",), ""),
        (("{a[share]:.0%} of {a[none]:d}",), ""),
    ],
)
def test_clause_without_value_is_left_out(clauses: tuple[str, ...], expected: str) -> None:
    assert fill(RESULTS, *clauses) == expected


def test_every_figure_in_a_sentence_exists() -> None:
    results = measured([*MADE, ("/slam/status", StatusRecord(0, "LOST", "warning", ""))]).to_json_dict()
    clauses = [clause for line in SUMMARY.values() for clause in line]
    keys = [key.replace("][", ".").replace("[", ".") for clause in clauses for key in re.findall(r"{([^:]*)]", clause)]
    assert len(keys) > 30
    for key in set(keys) - {"closures.proposer_counts.descriptor"}:
        parent, _, name = key.rpartition(".")
        assert name in value_at(results, parent), key


def test_summary_gives_reasons_of_what_is_missing() -> None:
    lines = summarize(evaluate(EvaluationRecords()).to_json_dict())
    assert set(lines) == set(SUMMARY)
    assert all(line.startswith("not measured: ") for line in lines.values())
