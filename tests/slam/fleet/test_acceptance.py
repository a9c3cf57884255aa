"""Which recognised places join two maps."""

from __future__ import annotations

import numpy as np
import pytest

from slam.common.config import Config
from slam.fleet.acceptance import judge_pairs
from slam.fleet.joins import Join


def join(log_odds: float, *, reference_map: int = 0, query_map: int = 1) -> Join:
    nothing = np.zeros((0, 2), dtype=np.int64)
    return Join(query_map, reference_map, 0, np.eye(4), np.eye(4), np.eye(6), log_odds, nothing)


def test_a_pair_has_all_its_joins_and_is_as_sure_as_the_surest() -> None:
    first, second = judge_pairs(3, [join(20.0), join(5.0), join(3.0, query_map=2), join(30.0)], Config())
    assert (first.first, first.second, second.first, second.second) == (0, 1, 0, 2)
    assert first.accepted
    assert [each.log_odds for each in first.joins] == [20.0, 5.0, 30.0]
    assert first.surest is first.joins[2]
    assert not second.accepted


@pytest.mark.parametrize(("log_odds", "is_accepted"), [(10.9, False), (11.1, True)])
def test_all_pairs_of_maps_share_the_probability_of_an_error(log_odds: float, is_accepted: bool) -> None:
    """Of four maps there are six pairs: 9.2 nats for an error in 10,000, 1.8 for the pairs."""
    (pair,) = judge_pairs(4, [join(log_odds)], Config())
    assert pair.accepted is is_accepted
    assert ("less than 11.0" in pair.reason) is not is_accepted
