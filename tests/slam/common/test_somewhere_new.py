"""The likelihood of "somewhere new", against the terms of the mixture."""

from __future__ import annotations

import numpy as np
import pytest

from slam.common.somewhere_new import log_somewhere_new


def test_without_other_places_it_is_clutter() -> None:
    assert log_somewhere_new(np.zeros(0), np.zeros(0)) == 0.0


def test_fits_by_chance_do_not_count() -> None:
    assert log_somewhere_new(np.array([20.0, 24.0]), np.array([-25.0, -25.0])) == 0.0


def test_places_that_fit_better_than_by_chance_have_equal_shares_with_clutter() -> None:
    ratios, log_uniform = np.array([40.0, 38.0]), np.full(2, -10.0)
    assert log_somewhere_new(ratios, log_uniform) == pytest.approx(np.log((1.0 + np.exp(ratios).sum()) / 3.0))
    aligned = np.array([-4.0, -5.0])
    expected = np.log((1.0 + np.exp(ratios + aligned).sum()) / 3.0)
    assert log_somewhere_new(ratios, log_uniform, aligned) == pytest.approx(expected)


def test_share_is_the_probability_that_a_fit_is_no_chance() -> None:
    share = 1.0 - np.exp(-2.0)
    expected = np.log((1.0 + share * np.exp(12.0)) / (1.0 + share))
    assert log_somewhere_new(np.array([12.0]), np.array([-10.0])) == pytest.approx(expected)
