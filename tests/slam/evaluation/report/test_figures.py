"""Sentences and tables around the figures of an evaluation."""

from __future__ import annotations

import pytest

from slam.evaluation.evaluate import evaluate
from slam.evaluation.inputs.records import EvaluationRecords
from slam.evaluation.report.figures import SUMMARY, fill, format_number, summarize, value_at
from slam.evaluation.report.tables import make_tables

RESULTS = {"a": {"error_m": 0.25, "share": 0.5, "count": 3, "none": None}, "text": "x"}


@pytest.mark.parametrize(
    ("clauses", "expected"),
    [
        (("error {a.error_m:.3f} m", ", {a.count} found"), "error 0.250 m, 3 found"),
        (("error {a.none:.3f} m", ", {a.share:.2%} right"), "50.00 % right"),
        (("{a.none}", " (in parentheses)"), ""),
        (("{a.missing.deeper}",), ""),
        (("{a.share:.0%} of {a.none}",), ""),
    ],
)
def test_clause_without_value_is_left_out(clauses: tuple[str, ...], expected: str) -> None:
    assert fill(RESULTS, *clauses) == expected


def test_every_figure_in_a_sentence_exists() -> None:
    results = evaluate(EvaluationRecords()).to_json_dict()
    clauses = [clause for line in SUMMARY.values() for clause in line]
    keys = {part.split("}")[0].split(":")[0] for clause in clauses for part in clause.split("{")[1:]}
    assert len(keys) > 30
    for key in keys:
        parent, _, name = key.rpartition(".")
        owner = value_at(results, parent)
        assert owner is None or name in owner, key


def test_summary_gives_reasons_of_what_is_missing() -> None:
    lines = summarize(evaluate(EvaluationRecords()).to_json_dict())
    assert set(lines) == set(SUMMARY)
    assert all(line.startswith("not measured: ") for line in lines.values())


def test_tables_of_nothing_are_empty() -> None:
    assert set(make_tables(evaluate(EvaluationRecords()).to_json_dict())) == {"calibration"}


def test_numbers_keep_four_digits() -> None:
    values = (1.27485, 3723.24, 0.0, None, float("nan"), 1e-9, 12345678.0)
    assert [format_number(value) for value in values] == ["1.275", "3723", "0.000", "–", "–", "1e-09", "1.23e+07"]
