from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.optimize import least_squares as scipy_least_squares
from scipy.spatial.transform import Rotation

from slam.common.arrays import FloatArray, IntArray
from slam.common.geometry import apply, invert, make_transform, skew, transform_from_xyz_yaw
from slam.registration.estimate import _covariance
from slam.registration.parameters import RegistrationConfig
from slam.registration.refinement import least_squares, make_columns
from slam.registration.registration import Registration, refine, register
from tests.helpers.registration_problems import Problem, draw_problem, street_objects

SIGMA_M = 0.2
CONFIG = RegistrationConfig(height_sigma_m=0.05)


def found_by(
    query: FloatArray,
    reference: FloatArray,
    correspondences: IntArray,
    config: RegistrationConfig = CONFIG,
    *,
    count: int = 1,
    sigma_m: float = SIGMA_M,
) -> list[Registration]:
    return register(
        query,
        reference,
        correspondences,
        config,
        query_sigmas=np.full(len(query), sigma_m),
        reference_sigmas=np.full(len(reference), 0.05),
        count=count,
    )


def solve(problem: Problem, config: RegistrationConfig = CONFIG) -> Registration:
    return found_by(problem.query, problem.reference, problem.correspondences, config)[0]


def one_to_one(count: int) -> IntArray:
    return np.stack([np.arange(count)] * 2, axis=1)


def everything(queries: int, references: int) -> IntArray:
    return np.argwhere(np.ones((queries, references), dtype=bool))


def is_one_to_one(registration: Registration) -> bool:
    return all(len(set(side.tolist())) == len(side) for side in registration.pairs.T)


def logarithm(T: FloatArray) -> FloatArray:
    """GTSAM's Pose3.Logmap (6,): rotation, then the translation taken back through the left Jacobian."""
    w = Rotation.from_matrix(T[:3, :3]).as_rotvec()
    W = np.array([[0.0, -w[2], w[1]], [w[2], 0.0, -w[0]], [-w[1], w[0], 0.0]])
    angle = max(float(np.linalg.norm(w)), 1e-9)
    factor = (1.0 - angle * np.sin(angle) / (2.0 * (1.0 - np.cos(angle)))) / angle**2 if angle > 1e-4 else 1.0 / 12.0
    return np.concatenate([w, (np.eye(3) - 0.5 * W + factor * W @ W) @ T[:3, 3]])


@pytest.mark.parametrize("false_share", [0.0, 0.5, 0.9])
@pytest.mark.parametrize("seed", range(8))
def test_the_pose_is_found_among_false_correspondences(seed: int, false_share: float) -> None:
    problem = draw_problem(120, false_share, rng=np.random.default_rng(seed))
    registration = solve(problem)
    assert registration.T_reference_query is not None
    error_m, error_deg = problem.error(registration.T_reference_query)
    assert error_m < 0.5
    assert error_deg < 1.0
    assert is_one_to_one(registration)
    assert len(registration.pairs) >= 0.8 * 120 * (1.0 - false_share)
    assert np.linalg.det(registration.T_reference_query[:3, :3]) == pytest.approx(1.0)


@pytest.mark.parametrize(("count", "false_share"), [(500, 0.98), (1500, 0.985), (3000, 0.99)])
def test_many_correspondences_nearly_all_false(count: int, false_share: float) -> None:
    for seed in range(3):
        problem = draw_problem(count, false_share, rng=np.random.default_rng(seed))
        T_reference_query = solve(problem).T_reference_query
        assert T_reference_query is not None
        assert problem.error(T_reference_query)[0] < 0.5


def test_coordinates_far_from_the_origin_change_nothing() -> None:
    problem = draw_problem(100, 0.5, rng=np.random.default_rng(1))
    away = np.array([4.5e5, 5.4e6, 300.0])
    near = solve(problem)
    far = found_by(problem.query, problem.reference + away, problem.correspondences)[0]
    np.testing.assert_allclose(far.T_reference_query[:3, 3] - away, near.T_reference_query[:3, 3], atol=1e-5)
    np.testing.assert_allclose(far.covariance, near.covariance, rtol=1e-5, atol=1e-12)


@pytest.mark.parametrize("estimate_scale", [False, True])
def test_least_squares_against_a_general_optimiser(estimate_scale: bool) -> None:
    config = RegistrationConfig(estimate_scale=estimate_scale)
    for seed in range(10):
        rng = np.random.default_rng(seed)
        query, reference = rng.normal(0.0, 20.0, (12, 3)), rng.normal(0.0, 20.0, (12, 3))
        reference += apply(transform_from_xyz_yaw(rng.normal(size=3), rng.uniform(-3.0, 3.0)), 2.0 * query)
        sigmas = rng.uniform(0.1, 2.0, (2, 12))
        columns = make_columns(query, reference, one_to_one(12), sigmas[0], sigmas[1], config)
        weights = rng.uniform(0.1, 1.0, 12)
        start = np.array([[1.0, 0.0, 0.0, 0.0, 0.0, 1.0]])
        solved = least_squares(start, weights[None], columns, config)[0]
        scale = np.hypot(solved[0], solved[1])
        per_axis = np.sqrt(weights)[:, None] / columns.sigma[:, [0, 0, 1]]

        def planar(x: FloatArray) -> FloatArray:
            turn = np.array([[np.cos(x[0]), np.sin(x[0])], [-np.sin(x[0]), np.cos(x[0])]])
            moved = x[3:].sum(initial=0.0 if estimate_scale else 1.0) * columns.query[:, :2] @ turn + x[1:3]  # noqa: B023
            residuals = ((columns.reference[:, :2] - moved) * per_axis[:, :2]).ravel()  # noqa: B023
            return np.append(residuals, (x[3:] - 1.0) / config.scale_sigma)

        guess = [np.arctan2(solved[1], solved[0]) + 0.1, 0.0, 0.0, *[1.0] * estimate_scale]
        optimum = scipy_least_squares(planar, guess, xtol=1e-15, ftol=1e-15, gtol=1e-15).x
        expected = optimum[3] if estimate_scale else 1.0
        np.testing.assert_allclose(solved[:2] / scale, [np.cos(optimum[0]), np.sin(optimum[0])], atol=1e-6)
        np.testing.assert_allclose(solved[2:4], optimum[1:3], atol=1e-5)
        assert scale == pytest.approx(solved[5]) == pytest.approx(expected, rel=1e-6)
        rise = columns.reference[:, 2] - scale * columns.query[:, 2]
        assert solved[4] == pytest.approx(np.average(rise, weights=per_axis[:, 2] ** 2))


@pytest.mark.parametrize(
    "config",
    [
        RegistrationConfig(height_sigma_m=0.3),
        RegistrationConfig(height_sigma_m=0.3, estimate_scale=True, scale_sigma=0.02),
    ],
)
def test_covariance_against_monte_carlo(config: RegistrationConfig) -> None:
    rng = np.random.default_rng(0)
    query_gt = street_objects(25, rng=rng) + np.array([40.0, -30.0, 1.0])
    query_sigmas, reference_sigmas = rng.uniform(0.1, 0.5, 25), rng.uniform(0.05, 0.2, 25)
    errors, covariances = [], []
    for _ in range(300):
        tilt = Rotation.from_rotvec([*rng.normal(0.0, config.tilt_sigma_rad, 2), 0.0]).as_matrix()
        T_gt = transform_from_xyz_yaw(rng.normal(0.0, 20.0, 3), rng.uniform(-3.0, 3.0))
        T_gt = T_gt @ make_transform(tilt, np.zeros(3))
        scale = rng.normal(1.0, config.scale_sigma) if config.estimate_scale else 1.0
        reference = apply(T_gt, scale * query_gt) + reference_sigmas[:, None] * rng.normal(size=(25, 3))
        query = query_gt + query_sigmas[:, None] * rng.normal(size=(25, 3))
        reference[:, 2] += rng.normal(0.0, config.height_sigma_m, 25)
        registration = register(
            query, reference, one_to_one(25), config,
            query_sigmas=query_sigmas, reference_sigmas=reference_sigmas,
        )[0]  # fmt: skip
        assert registration.T_reference_query is not None
        assert registration.covariance is not None
        errors.append(logarithm(invert(registration.T_reference_query) @ T_gt))
        covariances.append(registration.covariance)
    xi = np.array(errors)
    nees = np.einsum("ni,ni->n", xi, np.linalg.solve(np.array(covariances), xi[..., None])[..., 0])
    assert 4.6 < nees.mean() < 6.9
    # Axis by axis, in standard deviations: none of the six may hide behind the others.
    spread = (xi / np.sqrt(np.array([np.diag(P) for P in covariances]))).std(axis=0)
    assert spread.min() > 0.75
    assert spread.max() < 1.2


def test_precise_objects_count_for_more() -> None:
    errors = {True: [], False: []}
    for seed in range(40):
        rng = np.random.default_rng(seed)
        reference = street_objects(20, rng=rng)
        sigmas = np.where(np.arange(20) % 2, 0.05, 1.0)
        query = reference + sigmas[:, None] * rng.normal(size=(20, 3))
        for told, given_sigmas in ((True, sigmas), (False, np.full(20, 0.7))):
            registration = register(
                query, reference, one_to_one(20), CONFIG,
                query_sigmas=given_sigmas, reference_sigmas=np.full(20, 0.05),
            )[0]  # fmt: skip
            centre = reference.mean(axis=0, keepdims=True)
            errors[told].append(np.linalg.norm(apply(registration.T_reference_query, centre) - centre))
    assert np.median(errors[True]) < 0.5 * np.median(errors[False])


def test_everything_may_be_everything() -> None:
    rng = np.random.default_rng(5)
    reference = street_objects(40, rng=rng)
    T_reference_query = transform_from_xyz_yaw(np.array([5.0, 7.0, 0.1]), 2.0)
    query = apply(invert(T_reference_query), reference[:15]) + rng.normal(0.0, 0.1, (15, 3))
    registration = found_by(query, reference, everything(15, 40))[0]
    assert is_one_to_one(registration)
    np.testing.assert_array_equal(registration.pairs, one_to_one(15))


def test_crowded_objects_are_assigned_so_that_most_agree() -> None:
    """Greedy nearest neighbours would give the pair in the middle away and leave two objects alone."""
    reference = np.array([[0.0, 0, 0], [40.0, 0, 0], [0.0, 40, 0], [20.0, 20.0, 0], [20.4, 20.0, 0]])
    query = np.array([[0.0, 0, 0], [40.0, 0, 0], [0.0, 40, 0], [20.25, 20.0, 0], [20.65, 20.0, 0]])
    registration = found_by(query, reference, everything(5, 5))[0]
    np.testing.assert_array_equal(registration.pairs, one_to_one(5))


def test_a_correspondence_given_twice_counts_once() -> None:
    problem = draw_problem(60, 0.5, rng=np.random.default_rng(2))
    twice = found_by(problem.query, problem.reference, np.repeat(problem.correspondences, 2, axis=0))[0]
    once = solve(problem)
    assert is_one_to_one(twice)
    assert twice.score == pytest.approx(once.score, rel=1e-3)


@pytest.mark.parametrize("count", [100, 800])
def test_the_order_of_objects_and_correspondences_does_not_matter(count: int) -> None:
    problem = draw_problem(count, 0.8, rng=np.random.default_rng(7))
    rng = np.random.default_rng(8)
    order_q, order_r = rng.permutation(len(problem.query)), rng.permutation(len(problem.reference))
    new_q, new_r = np.argsort(order_q), np.argsort(order_r)
    pairs = problem.correspondences
    moved = rng.permutation(np.stack([new_q[pairs[:, 0]], new_r[pairs[:, 1]]], axis=1))
    one, other = solve(problem), found_by(problem.query[order_q], problem.reference[order_r], moved)[0]
    np.testing.assert_allclose(one.T_reference_query, other.T_reference_query, atol=1e-3)
    assert one.score == pytest.approx(other.score, rel=1e-3)
    named = {(int(order_q[q]), int(order_r[r])) for q, r in other.pairs}
    assert len(named ^ {(int(q), int(r)) for q, r in one.pairs}) <= 1


def test_a_place_that_exists_twice_is_found_twice() -> None:
    rng = np.random.default_rng(11)
    block = street_objects(20, rng=rng)
    reference = np.concatenate([block, apply(transform_from_xyz_yaw(np.array([300.0, 0.0, 0.0]), 1.0), block)[:15]])
    query = block + rng.normal(0.0, 0.1, block.shape)
    results = found_by(query, reference, everything(20, 35), count=3)
    assert len(results) >= 2
    assert [len(r.pairs) for r in results[:2]] == [20, 15]
    assert all(a.score >= b.score for a, b in pairwise(results))
    np.testing.assert_allclose(results[1].T_reference_query[:3, 3], [300.0, 0.0, 0.0], atol=0.5)
    if len(results) > 2:
        assert results[2].score < 0.5 * results[1].score
    assert len(found_by(query, block, one_to_one(20), count=3)) == 1


def test_many_inliers_leave_room_for_another_place() -> None:
    rng = np.random.default_rng(12)
    block = street_objects(400, rng=rng)
    copy = apply(transform_from_xyz_yaw(np.array([900.0, 0.0, 0.0]), 1.0), block)[:300]
    pairs = np.concatenate([one_to_one(400), np.stack([np.arange(300), np.arange(400, 700)], axis=1)])
    query = block + rng.normal(0.0, 0.1, block.shape)
    results = found_by(query, np.concatenate([block, copy]), rng.permutation(pairs), count=2)
    assert [len(r.pairs) for r in results] == [400, 300]


LINE = np.column_stack([np.linspace(0.0, 60.0, 8) ** 1.05, np.zeros(8), np.zeros(8)])


def test_objects_in_a_row_determine_yaw() -> None:
    T_gt = transform_from_xyz_yaw(np.array([3.0, -8.0, 0.5]), 2.5)
    level = found_by(LINE, apply(T_gt, LINE), one_to_one(8))[0]
    np.testing.assert_allclose(level.T_reference_query, T_gt, atol=1e-6)
    sigma_yaw, sigma_tilt = np.sqrt(level.covariance[2, 2]), np.sqrt(level.covariance[0, 0])
    assert sigma_yaw < 0.01
    assert sigma_tilt == pytest.approx(CONFIG.tilt_sigma_rad)


def test_a_short_row_knows_its_heading_less_well() -> None:
    sigmas = []
    for length in (5.0, 50.0):
        points = np.column_stack([np.linspace(0.0, length, 8), np.zeros(8), np.zeros(8)])
        sigmas.append(np.sqrt(found_by(points, points, one_to_one(8))[0].covariance[2, 2]))
    assert sigmas[0] == pytest.approx(10.0 * sigmas[1], rel=0.01)


def test_a_mirrored_constellation_is_no_match() -> None:
    for seed in range(10):
        reference = street_objects(40, rng=np.random.default_rng(seed))
        registration = found_by(reference * [1.0, -1.0, 1.0], reference, one_to_one(40))[0]
        assert len(registration.pairs) <= 12
        if registration.T_reference_query is not None:
            assert np.linalg.det(registration.T_reference_query[:3, :3]) == pytest.approx(1.0)


def test_a_constellation_at_another_height_or_scale_is_no_match() -> None:
    reference = street_objects(30, rng=np.random.default_rng(1))
    assert len(found_by(1.3 * reference, reference, one_to_one(30))[0].pairs) < 10
    steep = reference + np.column_stack([np.zeros((30, 2)), 0.3 * reference[:, 0]])
    assert len(found_by(steep, reference, one_to_one(30))[0].pairs) < 15


SQUARE = np.array([[0.0, 0, 0], [20.0, 0, 0], [20.0, 20, 0], [0.0, 20, 0]])


@pytest.mark.parametrize(
    ("query", "reference", "pairs", "reason"),
    [
        (SQUARE, SQUARE, np.zeros((0, 2), np.int64), "no correspondences"),
        (np.zeros((0, 3)), np.zeros((0, 3)), np.zeros((0, 2), np.int64), "no correspondences"),
        (SQUARE, SQUARE, np.array([[0, 0]]), "one query object"),
        (SQUARE, SQUARE, np.array([[1, 0], [1, 2], [1, 3]]), "one query object"),
        (SQUARE, SQUARE, np.array([[0, 1], [2, 1], [3, 1]]), "one reference object"),
        (SQUARE[[0, 0, 1, 2]], SQUARE, one_to_one(2), "2 query objects are within 0.00 m"),
        (SQUARE, SQUARE[[2, 2, 2, 2]], one_to_one(4), "within 0.00 m"),
        (SQUARE * [0, 0, 1] + [[0, 0, 0], [0, 0, 9], [0, 0, 5], [0, 0, 1]], SQUARE, one_to_one(4), "within 0.00 m"),
        (SQUARE, SQUARE, one_to_one(2), "only 2 objects"),
        (SQUARE, 3.0 * SQUARE, one_to_one(4), "no two correspondences"),
        (SQUARE, SQUARE + np.outer([0, 5, 15, 30], [0, 0, 1]), one_to_one(4), "no two correspondences"),
        (SQUARE[:3], SQUARE[:3] * [[1, 1, 1], [1, 1, 1], [4, 4, 1]], one_to_one(3), "fewer than 3"),
    ],
)
def test_what_determines_nothing_has_a_reason(
    query: FloatArray, reference: FloatArray, pairs: IntArray, reason: str
) -> None:
    registration = found_by(np.asarray(query, float), np.asarray(reference, float), pairs)[0]
    assert reason in registration.reason
    assert registration.T_reference_query is None
    assert registration.covariance is None
    assert len(registration.pairs) == 0


coordinates = st.sampled_from([0.0, 1.0, 4.0, 7.5, 30.0])
points = st.lists(st.tuples(coordinates, coordinates, coordinates), min_size=0, max_size=6)


@settings(max_examples=150, deadline=None)
@given(points, points, st.booleans(), st.sampled_from([2, 3]), st.sampled_from([0.1, 0.5, 8.0]))
def test_small_constellations_never_fail(
    query: list[tuple[float, ...]],
    reference: list[tuple[float, ...]],
    estimate_scale: bool,
    least: int,
    sigma_m: float,
) -> None:
    config = RegistrationConfig(estimate_scale=estimate_scale, min_inliers=least)
    q, r = np.reshape(query, (-1, 3)).astype(float), np.reshape(reference, (-1, 3)).astype(float)
    with np.errstate(divide="raise", invalid="raise", over="raise"):
        results = found_by(q, r, everything(len(q), len(r)), config, count=3, sigma_m=sigma_m)
    assert results
    for result in results:
        assert (result.T_reference_query is None) == (result.covariance is None) == bool(result.reason)
        if result.T_reference_query is None or result.covariance is None:
            continue
        assert np.isfinite(result.T_reference_query).all()
        assert is_one_to_one(result)
        assert len(result.pairs) >= least
        assert np.linalg.eigvalsh(result.covariance)[0] > 0.0


def test_a_scale_is_estimated() -> None:
    rng = np.random.default_rng(4)
    reference = street_objects(40, rng=rng)
    T_gt = transform_from_xyz_yaw(np.array([50.0, 60.0, 0.0]), 0.7)
    query = apply(invert(T_gt), reference) / 1.04 + rng.normal(0.0, 0.1, reference.shape)
    registration = found_by(query, reference, one_to_one(40), RegistrationConfig(estimate_scale=True))[0]
    assert registration.scale == pytest.approx(1.04, abs=0.003)
    assert len(registration.pairs) == 40
    np.testing.assert_allclose(registration.T_reference_query[:3, 3], T_gt[:3, 3], atol=0.3)
    np.testing.assert_allclose(np.linalg.det(registration.T_reference_query[:3, :3]), 1.0)


def near_place(seed: int) -> tuple[FloatArray, IntArray, FloatArray, IntArray, FloatArray]:
    """24 of 60 objects and 6 that are new: query and labels, reference and labels, T_reference_query."""
    rng = np.random.default_rng(seed)
    reference, labels = street_objects(60, rng=rng), rng.integers(0, 4, 60)
    T_gt = transform_from_xyz_yaw(rng.normal(0.0, 50.0, 3), rng.uniform(-3.0, 3.0))
    seen = rng.permutation(60)[:24]
    query = np.concatenate([reference[seen] + rng.normal(0.0, 0.15, (24, 3)), street_objects(6, rng=rng)])
    return apply(invert(T_gt), query), np.append(labels[seen], rng.integers(0, 4, 6)), reference, labels, T_gt


def from_near(
    query: FloatArray, query_labels: IntArray, reference: FloatArray, labels: IntArray, T_initial: FloatArray
) -> Registration:
    return refine(
        query, query_labels, reference, labels, T_initial, CONFIG,
        query_sigmas=np.full(len(query), SIGMA_M), reference_sigmas=np.full(len(reference), 0.05),
    )  # fmt: skip


def nudged(T: FloatArray, query: FloatArray, offset: FloatArray, yaw_rad: float) -> FloatArray:
    """``T``, turned and moved about the centre of the query."""
    centre = query.mean(axis=0)
    turn = transform_from_xyz_yaw(np.zeros(3), yaw_rad)
    turn[:3, 3] = centre - turn[:3, :3] @ centre + offset
    return np.asarray(T @ turn)


def test_refinement_from_an_approximate_pose() -> None:
    for seed in range(10):
        query, query_labels, reference, labels, T_gt = near_place(seed)
        rng = np.random.default_rng(100 + seed)
        for _ in range(5):
            start = nudged(T_gt, query, rng.normal(0.0, 0.7, 3), rng.normal(0.0, 0.02))
            registration = from_near(query, query_labels, reference, labels, start)
            assert registration.T_reference_query is not None
            assert len(registration.pairs) >= 22
            assert is_one_to_one(registration)
            assert (query_labels[registration.pairs[:, 0]] == labels[registration.pairs[:, 1]]).all()
            error = logarithm(invert(registration.T_reference_query) @ T_gt)
            assert error @ np.linalg.solve(registration.covariance, error) < 30.0


def test_refinement_of_the_wrong_place_finds_little() -> None:
    query, query_labels, reference, labels, T_gt = near_place(0)
    elsewhere = nudged(T_gt, query, np.array([14.0, 9.0, 0.0]), 0.0)
    nowhere = nudged(T_gt, query, np.array([4000.0, 0.0, 0.0]), 0.0)
    wrong_labels = from_near(query, np.roll(query_labels, 1), reference, labels, T_gt)
    first = from_near(query, query_labels, reference, labels, elsewhere)
    second = from_near(query, query_labels, reference, labels, nowhere)
    assert len(first.pairs) < 12
    assert len(wrong_labels.pairs) < 14
    assert second.T_reference_query is None
    assert "near one of its label" in second.reason


def test_refinement_of_nothing() -> None:
    empty, none, same = np.zeros((0, 3)), np.zeros(0, np.int64), np.zeros(4, np.int64)
    assert "label" in from_near(empty, none, SQUARE, same, np.eye(4)).reason
    assert "label" in from_near(SQUARE, np.ones(4, np.int64), SQUARE, same, np.eye(4)).reason
    assert "1 pairs" in from_near(SQUARE[:1], same[:1], SQUARE, same, np.eye(4)).reason
    stack = from_near(SQUARE[[0, 0, 0]], np.arange(3), SQUARE[[0, 0, 0]], np.arange(3), np.eye(4))
    assert "heading" in stack.reason


def test_covariance_moves_from_the_middle_to_the_origin_of_the_query() -> None:
    A = np.random.default_rng(0).normal(size=(7, 7))
    information, middle = A @ A.T + np.eye(7), np.array([20.0, -30.0, 4.0])
    there = _covariance(information, np.zeros(3), middle, CONFIG)
    Ad = np.eye(6)
    Ad[3:, :3] = skew(middle)
    np.testing.assert_allclose(_covariance(information, middle, middle, CONFIG), Ad @ there @ Ad.T, rtol=1e-9)
