"""Degradations as they are asked for."""

from __future__ import annotations

import pytest

from slam.common.errors import ConfigurationError
from slam.sweeps.degradations import (
    DEFAULT_SPECIFICATIONS,
    EVERY_FAULT,
    cases_of,
    is_random,
    parse_degradations,
)


def parse(text: str) -> str:
    return parse_degradations([text])[-1]


def test_several_faults_make_one_degradation() -> None:
    found = cases_of(parse("gyro_bias,field-of-view=90, keep_label=tree:lamp,reversed,dropout=.3,time_offset=-0.1"))
    assert [case.name for case in found] == [
        "gyro_bias=3:10", "field_of_view=90", "keep_label=tree:lamp", "reversed", "dropout=0.3", "time_offset=-0.1",
    ]  # fmt: skip


def test_the_log_as_it_is_comes_first_and_everything_once() -> None:
    assert parse_degradations(["dropout=0.30", "reversed", "dropout=.3"]) == [
        "undegraded",
        "dropout=0.3",
        "reversed",
    ]


def test_default_degradations_are_random() -> None:
    found = parse_degradations([])
    assert found == ["undegraded", *DEFAULT_SPECIFICATIONS]
    assert [is_random(each) for each in found] == [False] + [True] * 5


def test_every_fault_is_a_degradation_of_its_own() -> None:
    found = parse_degradations([EVERY_FAULT, "dropout=0.3,reversed"])
    assert {"undegraded", "heading_jump=5:0.5", "labels_random", "dropout=0.3,reversed"} < set(found)
    assert all(len(cases_of(each)) == 1 for each in found[1:-1])


@pytest.mark.parametrize("text", ["field_of_view=90", "reversed", "max_range=20", "time_offset=0.2", "drop_label=tree"])
def test_the_seed_does_not_matter_where_nothing_is_random(text: str) -> None:
    assert not is_random(parse(text))


@pytest.mark.parametrize(
    ("text", "told"),
    [
        ("drop=0.3", "did you mean dropout?"),
        ("", "unknown fault"),
        ("dropout=3", "'3' is not allowed"),
        ("keep_label", "needs a label"),
        ("field_of_view=wide", "is not allowed"),
        ("dropout=nan", "is not allowed"),
    ],
)
def test_what_cannot_be_is_refused_in_one_line(text: str, told: str) -> None:
    with pytest.raises(ConfigurationError) as caught:
        parse(text)
    assert str(caught.value).startswith(f"--degrade {text!r}")
    assert told in str(caught.value)
    assert "\n" not in str(caught.value)
