"""Cells of votes for poses: which peaks they form."""

from __future__ import annotations

import numpy as np
import pytest

from slam.registration.pose_voting import _Votes

LONGEST_M = np.full(9, 20.0)
"""Size of the matches; a heading has a cell of 1 / 20 rad, a place one of 1 m."""


def peaks_of(turns: np.ndarray, places: np.ndarray, count: int, weights: np.ndarray | None = None) -> list[list[int]]:
    given = np.ones(len(turns)) if weights is None else weights
    votes = _Votes.of(turns, places, given, LONGEST_M, 1.0, 0.0)
    rows, starts = votes.peaks(count)
    return [sorted(each.tolist()) for each in np.split(rows, starts[1:])]


@pytest.mark.parametrize("count", [1, 2])
def test_peak_with_most_votes_in_and_around_its_cell_is_first(count: int) -> None:
    """Five votes in one cell are more than four in three cells side by side."""
    beside = [[10.5, 0.5]] * 2 + [[11.5, 0.5], [10.5, 1.5]]
    places = np.array([*beside, *[[0.5, 0.5]] * 5])
    assert peaks_of(np.ones(9, dtype=complex), places, count) == [[4, 5, 6, 7, 8], [0, 1, 2, 3]][:count]


def test_heavy_votes_are_more_than_many_light_ones() -> None:
    places = np.array([[10.5, 0.5]] * 4 + [[0.5, 0.5]] * 5)
    weights = np.array([2.0] * 4 + [1.0] * 5)
    assert peaks_of(np.ones(9, dtype=complex), places, 2, weights) == [[0, 1, 2, 3], [4, 5, 6, 7, 8]]


def test_headings_on_either_side_of_half_a_turn_are_one_peak() -> None:
    turns = np.exp(1j * np.array([np.pi - 0.01] * 5 + [-np.pi + 0.01] * 4))
    assert peaks_of(turns, np.zeros((9, 2)), 5) == [list(range(9))]
