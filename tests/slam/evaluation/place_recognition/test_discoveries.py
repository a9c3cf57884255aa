from dataclasses import replace

import pytest

from slam.evaluation.place_recognition.closures import largest_false_share
from tests.slam.evaluation.loops import closure, judge, there_and_back

TRUTH = there_and_back()


def test_closures_are_counted_by_where_they_come_from() -> None:
    found = judge(
        [
            closure(180, 60, truth=TRUTH),
            closure(182, 58, truth=TRUTH, seed=180),
            closure(184, 56, truth=TRUTH, seed=182),
            closure(178, 62, truth=TRUTH, seed=180),
            closure(190, 50, truth=TRUTH, stage="acceptance"),
        ],
        TRUTH,
    )
    assert (found["found_count"], found["followed_count"], found["led_back_count"]) == (1, 2, 1)
    assert (found["independent_count"], found["independent_false_count"]) == (1, 0)


def test_accepted_closures_are_counted_by_proposer() -> None:
    retrieved, predicted = closure(180, 60, truth=TRUTH), closure(182, 58, truth=TRUTH, seed=180)
    for proposer, expected in (("descriptor", {"descriptor": 1, "prediction": 1}), ("hypothesis", {"descriptor": 0})):
        records = [replace(retrieved, proposer=proposer), replace(predicted, proposer="prediction")]
        assert judge(records, TRUTH)["proposer_counts"].items() >= expected.items()
    assert judge([retrieved], TRUTH)["proposer_counts"] == {}


def test_discoveries_that_share_a_submap_are_one() -> None:
    """Keyframes are 1 m apart: 160 and 200 share objects with what lies between them, and one false makes it false."""
    near = [closure(query, 240 - query, truth=TRUTH, shift_m=9.0 * (query == 200)) for query in (160, 200)]
    apart = [*near[:1], closure(220, 20, truth=TRUTH, shift_m=9.0)]
    one, two = judge(near, TRUTH), judge(apart, TRUTH)
    assert (one["independent_count"], one["independent_false_count"]) == (1, 1)
    assert (two["independent_count"], two["independent_false_count"]) == (2, 1)


def test_largest_false_share_follows_rule_of_three() -> None:
    for count in (10, 60, 341):
        share = largest_false_share(count, 0)
        assert share == pytest.approx(3.0 / count, rel=0.15)
        assert share == pytest.approx(1.0 - 0.05 ** (1.0 / count))
    assert largest_false_share(20, 2) == pytest.approx(0.2826, abs=1e-3)
    assert largest_false_share(3, 3) == 1.0
    assert largest_false_share(0, 0) is None
