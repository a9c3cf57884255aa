"""What objects say for and against a place: much where they are seen again, little where they stand in rows."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.special import betaln

from slam.common.arrays import FloatArray, IntArray
from slam.common.geometry import apply, invert
from slam.loop_closure.likelihood_ratio import (
    CLUTTER_RANGES,
    COVERAGE_RANGES,
    DETECTION_PROBABILITY,
    LEAST_COUNT,
    changed_log_likelihood_ratio,
    compute_log_likelihood_ratios,
)
from slam.object_map.submap import Submap
from tests.helpers.poses import pose_at

RANGE_M = 30.0
COVERAGE_M = COVERAGE_RANGES * RANGE_M
T_REFERENCE_QUERY = pose_at(30.0, -20.0, z=1.0, yaw=0.7)
SIGMA_M = 0.35
"""Of a landmark."""
HERE = np.eye(4)
NO_PAIRS = np.zeros((0, 2), int)
AROUND_AREA_M2 = np.pi * (CLUTTER_RANGES * RANGE_M) ** 2


def submap(positions: FloatArray, labels: IntArray | int = 0) -> Submap:
    count = len(positions)
    return Submap(positions, np.full(count, SIGMA_M), np.broadcast_to(labels, count), np.arange(count))


def seen(positions: FloatArray, labels: IntArray) -> Submap:
    """Objects in the frame of the query."""
    return submap(apply(invert(T_REFERENCE_QUERY), positions), labels)


def scattered(count: int, *, seed: int) -> tuple[FloatArray, IntArray]:
    """Objects of four classes in a square of 50 m around the origin."""
    rng = np.random.default_rng(seed)
    return np.column_stack([rng.uniform(-25.0, 25.0, (count, 2)), np.zeros(count)]), rng.integers(4, size=count)


def each_with_its_own(count: int) -> IntArray:
    return np.column_stack([np.arange(count), np.arange(count)])


def ratios_of(
    query: Submap, reference: Submap, pairs: IntArray, T: FloatArray = HERE, shares: FloatArray | None = None
) -> FloatArray:
    return compute_log_likelihood_ratios(query, reference, T, pairs, RANGE_M, shares)


def row_llr(spacing_m: float, *, row_heading_rad: float, heading_rad: float) -> float:
    """Evidence of a row of equal objects, placed with that heading, wrongly: shifted by one object along the row."""
    row = np.zeros((10, 3))
    row[:, 0] = spacing_m * np.arange(len(row))
    row = apply(pose_at(yaw=row_heading_rad), row)
    T_right = pose_at(yaw=heading_rad)
    T_wrong = T_right.copy()
    T_wrong[:3, 3] = row[1]
    pairs = np.column_stack([np.arange(9), np.arange(1, 10)])
    return ratios_of(submap(apply(invert(T_right), row)), submap(row), pairs, T_wrong).sum()


@pytest.mark.parametrize("heading_rad", [0.0, 0.9, np.pi])
def test_a_row_of_parked_cars_shifted_by_one_car_says_far_less_than_scattered_objects(heading_rad):
    positions, labels = scattered(10, seed=1)
    query = seen(positions, labels)
    apart = ratios_of(query, submap(positions, labels), each_with_its_own(10)[1:], T_REFERENCE_QUERY).sum()
    row = row_llr(6.0, row_heading_rad=heading_rad, heading_rad=heading_rad)
    assert row < 0.6 * apart


@pytest.mark.parametrize("turn_rad", [0.3, 0.9, np.pi / 2.0, -2.0])
def test_a_row_says_as_little_if_it_does_not_run_along_the_heading(turn_rad):
    along = row_llr(11.0, row_heading_rad=0.4, heading_rad=0.4)
    turned = row_llr(11.0, row_heading_rad=0.4, heading_rad=0.4 + turn_rad)
    assert turned == pytest.approx(along, rel=0.1)


def test_two_objects_that_are_near_are_no_row():
    """The nearest other one only shows a direction: along it the object is alone."""
    pair = submap(np.array([[0.0, 0.0, 0.0], [6.0, 6.0, 0.0]]))
    alone = submap(np.zeros((1, 3)))
    ratios = [ratios_of(query, query, each_with_its_own(len(query)))[0] for query in (pair, alone)]
    assert ratios[0] == pytest.approx(ratios[1])


def test_an_object_is_expected_only_within_reach_of_what_the_other_pass_saw():
    query = submap(np.array([[COVERAGE_M - 0.1, 0.0, 0.0], [COVERAGE_M + 0.1, 0.0, 0.0]]))
    ratios = ratios_of(query, submap(np.zeros((1, 3)), 1), NO_PAIRS)
    np.testing.assert_array_equal(ratios, [np.log(1.0 - DETECTION_PROBABILITY), 0.0])


def llr_of_a_match(density: float, off_m: float = 0.0) -> float:
    again = np.exp(-0.25 * (off_m / SIGMA_M) ** 2) / (2.0 * np.pi * 2.0 * SIGMA_M**2)
    return float(np.log(1.0 - DETECTION_PROBABILITY + DETECTION_PROBABILITY * again / density))


@pytest.mark.parametrize(("label", "density"), [(0, 2.0 / AROUND_AREA_M2), (1, 0.5 / AROUND_AREA_M2)])
def test_others_count_only_if_they_are_like_it(label, density):
    """Two of them across the direction of travel, 4 m away."""
    reference = submap(np.array([[0.0, 0.0, 0.0], [0.0, 4.0, 0.0], [0.0, -4.0, 0.0]]), np.array([0, label, label]))
    ratios = ratios_of(submap(np.zeros((1, 3))), reference, each_with_its_own(1))
    assert ratios.sum() == pytest.approx(llr_of_a_match(density), abs=1e-5)


@pytest.mark.parametrize("off_m", [0.3, 1.0])
def test_the_farther_from_where_it_should_be_the_less_an_object_says(off_m):
    query = submap(np.array([[0.6 * off_m, 0.8 * off_m, 5.0]]))
    ratios = ratios_of(query, submap(np.zeros((1, 3))), each_with_its_own(1))
    assert ratios.sum() == pytest.approx(llr_of_a_match(0.5 / AROUND_AREA_M2, off_m))


@pytest.mark.parametrize(("seen", "known"), [(0, 5), (5, 0), (0, 0)])
def test_the_llr_of_an_empty_query_or_reference_is_zero(seen, known):
    query, reference = submap(scattered(seen, seed=0)[0]), submap(scattered(known, seed=1)[0])
    ratios = ratios_of(query, reference, NO_PAIRS)
    assert ratios.tolist() == [0.0] * seen


def test_where_none_stands_around_a_rare_class_says_more_than_a_common_one():
    positions, _ = scattered(20, seed=3)
    labels = np.zeros(20, int)
    labels[0] = 1
    query = seen(positions[:1], labels[:1])
    reference = submap(positions, labels)
    pairs = each_with_its_own(1)

    def llr(*shares: float) -> float:
        return ratios_of(query, reference, pairs, T_REFERENCE_QUERY, np.array(shares)).sum()

    plain = ratios_of(query, reference, pairs, T_REFERENCE_QUERY).sum()
    assert llr(0.99, 0.01) > llr(0.8, 0.2) > llr(0.01, 0.99) > plain


def test_where_others_of_the_class_stand_around_its_share_in_the_map_does_not_matter():
    positions = np.array([[0.0, 0.0, 0.0], [2.0, 0.0, 0.0], [0.0, 2.0, 0.0]])
    query, reference = submap(positions[:1]), submap(positions)
    alone = ratios_of(query, reference, each_with_its_own(1))
    rare = ratios_of(query, reference, each_with_its_own(1), shares=np.array([0.001]))
    assert rare.sum() == alone.sum()


def test_compute_log_likelihood_ratios_does_not_depend_on_the_order_of_objects():
    rng, shares = np.random.default_rng(2), np.array([0.1, 0.2, 0.3, 0.4])
    positions, labels = scattered(20, seed=1)
    noisy, rows = positions + rng.normal(0.0, 0.3, (20, 3)), np.arange(20)
    of_query = noisy, rng.uniform(0.2, 0.5, 20), labels, rows, rng.uniform(0.3, 1.0, 20)
    reference = Submap(positions, rng.uniform(0.2, 0.5, 20), labels, rows)
    expected = ratios_of(Submap(*of_query), reference, each_with_its_own(9), shares=shares)
    backwards = Submap(*(each[::-1] for each in of_query))
    found = ratios_of(backwards, reference, np.array([19, 0]) + [-1, 1] * each_with_its_own(9), shares=shares)
    np.testing.assert_allclose(found[::-1], expected)


def test_a_landmark_that_may_not_exist_says_less_either_way():
    positions, labels = scattered(8, seed=1)
    reference, pairs = submap(positions, labels), each_with_its_own(7)
    sure = ratios_of(submap(positions, labels), reference, pairs)
    doubtful = replace(submap(positions, labels), existence=np.full(8, 0.5))
    unsure = ratios_of(doubtful, reference, pairs)
    np.testing.assert_allclose(np.expm1(unsure), 0.5 * np.expm1(sure))


@pytest.mark.parametrize("share", [1.0, 0.1])
def test_the_matched_object_is_no_clutter_of_its_own(share):
    """Alone within reach, an object matches as improbably as anywhere else, however near its match is."""
    shares = np.array([share])
    alone = submap(np.zeros((1, 3)))
    far = submap(np.array([[0.0, 0.0, 0.0], [0.0, 30.0, 0.0]]))
    ratios = [ratios_of(alone, reference, each_with_its_own(1), shares=shares).sum() for reference in (alone, far)]
    least_density = share * LEAST_COUNT / COVERAGE_M**2
    clutter = 0.5 / (AROUND_AREA_M2 + 0.5 / least_density)
    np.testing.assert_allclose(ratios, llr_of_a_match(clutter))


# A place that may have changed


def test_objects_without_a_match_are_a_beta_binomial():
    missed = np.log1p(-0.85)
    for count in (1, 6, 20):
        expected = betaln(8.5, 1.5 + count) - betaln(8.5, 1.5)
        assert changed_log_likelihood_ratio(np.full(count, missed)) == pytest.approx(expected, abs=0.01)
    assert changed_log_likelihood_ratio(np.zeros(9)) == pytest.approx(0.0)


def test_matches_among_many_changed_objects_count():
    """Four of 32 objects match: against the place if all are independent, not if the place has changed."""
    ratios = np.full(32, np.log1p(-0.85))
    ratios[:4] = 6.0
    assert ratios.sum() < -20.0
    expected = betaln(12.5, 29.5) - betaln(8.5, 1.5) + 4.0 * np.log((np.exp(6.0) - 0.15) / 0.85)
    assert changed_log_likelihood_ratio(ratios) == pytest.approx(expected, abs=0.1)
    assert expected > 0.0
