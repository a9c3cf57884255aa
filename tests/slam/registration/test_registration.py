import gtsam
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from slam.common.arrays import FloatArray, IntArray
from slam.common.config import Config
from slam.common.geometry import apply, invert, transform_from_xyz_yaw
from slam.object_map.submap import Submap
from slam.registration.registration import (
    TILT_SIGMA_RAD,
    LevelPose,
    Pairs,
    Registration,
    estimate,
    register,
    search_radius_m,
)
from tests.helpers.poses import motion_by, pose_at

SIGMA_M = 0.2
CONFIG = Config().calibrated({"objects.height_sigma_m": 0.05})


def street_objects(count: int, *, rng: np.random.Generator) -> FloatArray:
    """Objects (``count``, 3) m on both sides of two streets that cross, z up."""
    along, across = rng.uniform(-80.0, 80.0, count), 7.0 * rng.choice([-1.0, 1.0], count) + rng.normal(0.0, 0.5, count)
    planar = np.where(rng.random((count, 1)) < 0.5, np.stack([along, across], 1), np.stack([across, along], 1))
    return np.column_stack([planar, rng.uniform(0.0, 3.0, count)])


def from_near(
    query: FloatArray,
    query_labels: IntArray,
    reference: FloatArray,
    labels: IntArray,
    T_initial: FloatArray,
    config: Config = CONFIG,
    *,
    sigma_m: float | FloatArray = SIGMA_M,
    reference_sigma_m: float | FloatArray = 0.05,
) -> Registration:
    seen = Submap(query, np.zeros(len(query)) + sigma_m, query_labels, np.arange(len(query)))
    known = Submap(reference, np.zeros(len(reference)) + reference_sigma_m, labels, np.arange(len(reference)))
    return register(seen, known, T_initial, config)


def one_to_one(
    query: FloatArray, reference: FloatArray, T_initial: FloatArray | None = None, **more: object
) -> Registration:
    """Each object has a label of its own."""
    labels = np.arange(len(query))
    return from_near(query, labels, reference, labels, np.eye(4) if T_initial is None else T_initial, **more)


def is_one_to_one(registration: Registration) -> bool:
    return all(len(set(side.tolist())) == len(side) for side in registration.pairs.T)


def near_place(seed: int) -> tuple[FloatArray, IntArray, FloatArray, IntArray, FloatArray]:
    """24 of 60 objects and 6 that are new: query and labels, reference and labels, T_reference_query."""
    rng = np.random.default_rng(seed)
    reference, labels = street_objects(60, rng=rng), rng.integers(0, 4, 60)
    T_gt = transform_from_xyz_yaw(rng.normal(0.0, 50.0, 3), rng.uniform(-3.0, 3.0))
    seen = rng.permutation(60)[:24]
    query = np.concatenate([reference[seen] + rng.normal(0.0, 0.15, (24, 3)), street_objects(6, rng=rng)])
    return apply(invert(T_gt), query), np.append(labels[seen], rng.integers(0, 4, 6)), reference, labels, T_gt


def nudged(T: FloatArray, query: FloatArray, offset: FloatArray, yaw_rad: float) -> FloatArray:
    """``T``, turned and moved about the centre of the query."""
    centre = query.mean(axis=0)
    turn = pose_at(yaw=yaw_rad)
    turn[:3, 3] = centre - turn[:3, :3] @ centre + offset
    return np.asarray(T @ turn)


@pytest.mark.parametrize(("objects", "height_sigma_m"), [({}, 0.6), ({"objects.height_sigma_m": 0.2}, 0.2)])
def test_lengths_are_shares_of_the_sensor_range_unless_given(objects: dict[str, float], height_sigma_m: float) -> None:
    config = Config().calibrated({"detection.sensor_range_m": 60.0} | objects)
    assert search_radius_m(config) == pytest.approx(6.0)
    square = CORNERS[:4] - [10.0, 10.0, 0.0]
    height_variance = 4.0 * one_to_one(square, square, config=config).covariance[5, 5]
    assert height_variance == pytest.approx(SIGMA_M**2 + 0.05**2 + height_sigma_m**2, rel=0.1)


def test_refinement_from_an_approximate_pose() -> None:
    for seed in range(10):
        query, query_labels, reference, labels, T_gt = near_place(seed)
        rng = np.random.default_rng(100 + seed)
        for _ in range(5):
            start = nudged(T_gt, query, rng.normal(0.0, 0.7, 3), rng.normal(0.0, 0.02))
            registration = from_near(query, query_labels, reference, labels, start)
            assert len(registration.pairs) >= 22
            assert is_one_to_one(registration)
            assert (query_labels[registration.pairs[:, 0]] == labels[registration.pairs[:, 1]]).all()
            error = gtsam.Pose3.Logmap(gtsam.Pose3(invert(registration.T_reference_query) @ T_gt))
            assert error @ np.linalg.solve(registration.covariance, error) < 30.0


def test_refinement_of_the_wrong_place_finds_little() -> None:
    query, query_labels, reference, labels, T_gt = near_place(0)
    elsewhere = nudged(T_gt, query, np.array([14.0, 9.0, 0.0]), 0.0)
    nowhere = nudged(T_gt, query, np.array([4000.0, 0.0, 0.0]), 0.0)
    wrong_labels = from_near(query, np.roll(query_labels, 1), reference, labels, T_gt)
    assert len(from_near(query, query_labels, reference, labels, elsewhere).pairs) < 12
    assert len(wrong_labels.pairs) < 14
    assert "near one of its label" in from_near(query, query_labels, reference, labels, nowhere).reason


@pytest.mark.parametrize("scale", [1e-3, 20.0, 1e3])
def test_constellations_of_any_size_are_registered_alike(scale: float) -> None:
    query, query_labels, reference, labels, T_gt = near_place(3)
    poses = []
    for factor in (1.0, scale):
        lengths = {"detection.sensor_range_m": factor * 30.0, "objects.height_sigma_m": factor * 0.05}
        T = nudged(T_gt, query, np.array([0.7, -0.7, 0.0]), 0.01)
        T[:3, 3] *= factor
        sigmas = {"sigma_m": factor * SIGMA_M, "reference_sigma_m": factor * 0.05}
        found = from_near(
            factor * query, query_labels, factor * reference, labels, T, CONFIG.calibrated(lengths), **sigmas
        )
        poses.append(found.T_reference_query[:3, 3] / factor)
    np.testing.assert_allclose(poses[0], poses[1], rtol=0.0, atol=1e-6)


def test_every_other_pose_has_more_squared_residuals() -> None:
    for seed in range(10):
        rng = np.random.default_rng(seed)
        query, reference = rng.normal(0.0, 20.0, (2, 12, 3))
        q, r = query[:, 0] + 1j * query[:, 1], reference[:, 0] + 1j * reference[:, 1]
        sigmas, weights = rng.uniform(0.1, 2.0, (2, 12)), rng.uniform(0.1, 1.0, 12)
        pairs = Pairs(np.zeros((12, 2), np.int64), q, r, query[:, 2], reference[:, 2], *sigmas, *np.zeros((2, 3)))
        best = pairs.least_squares(LevelPose(1.0, 0.0, 0.0), weights)
        least = weights @ pairs.squared_residuals(best)
        for yaw, x, y, z in [*np.vstack([np.eye(4), -np.eye(4)]) * 1e-3, *rng.normal(0.0, 3.0, (20, 4))]:
            other = LevelPose(best.turn * np.exp(1j * yaw), best.shift + complex(x, y), best.rise + z)
            assert weights @ pairs.squared_residuals(other) > least


def test_covariance_against_monte_carlo() -> None:
    config, rng = CONFIG.calibrated({"objects.height_sigma_m": 0.3}), np.random.default_rng(0)
    query_gt = street_objects(25, rng=rng) + np.array([40.0, -30.0, 1.0])
    query_sigmas, reference_sigmas = rng.uniform(0.1, 0.5, 25), rng.uniform(0.05, 0.2, 25)
    errors, covariances = [], []
    for _ in range(300):
        tilt = motion_by([*rng.normal(0.0, TILT_SIGMA_RAD, 2), 0.0])
        T_level = transform_from_xyz_yaw(rng.normal(0.0, 20.0, 3), rng.uniform(-3.0, 3.0))
        T_gt = T_level @ tilt
        reference = apply(T_gt, query_gt) + reference_sigmas[:, None] * rng.normal(size=(25, 3))
        query = query_gt + query_sigmas[:, None] * rng.normal(size=(25, 3))
        reference[:, 2] += rng.normal(0.0, 0.3, 25)
        sigmas = {"sigma_m": query_sigmas, "reference_sigma_m": reference_sigmas}
        registration = one_to_one(query, reference, T_level, config=config, **sigmas)
        errors.append(gtsam.Pose3.Logmap(gtsam.Pose3(invert(registration.T_reference_query) @ T_gt)))
        covariances.append(registration.covariance)
    xi = np.array(errors)
    nees = np.einsum("ni,ni->n", xi, np.linalg.solve(np.array(covariances), xi[..., None])[..., 0])
    assert 4.6 < nees.mean() < 6.9
    # Axis by axis, in standard deviations: none of the six may hide behind the others.
    spread = (xi / np.sqrt(np.array([np.diag(P) for P in covariances]))).std(axis=0)
    assert spread.min() > 0.75
    assert spread.max() < 1.2


def test_crowded_objects_are_assigned_so_that_most_agree() -> None:
    """Greedy nearest neighbours would give the pair in the middle away and leave two objects alone."""
    reference = np.array([[0.0, 0, 0], [40.0, 0, 0], [0.0, 40, 0], [20.0, 20.0, 0], [20.4, 20.0, 0]])
    query = reference.copy()
    query[3:, 0] += 0.25
    same = np.zeros(5, np.int64)
    registration = from_near(query, same, reference, same, np.eye(4))
    np.testing.assert_array_equal(registration.pairs, np.stack([np.arange(5)] * 2, axis=1))


CORNERS = np.array([[0.0, 0, 0], [20.0, 0, 0], [0.0, 20, 0], [20.0, 20, 0], [9.0, 14, 0], [-8.0, 6, 0]])
NONE = np.zeros((0, 3))


@pytest.mark.parametrize("doubled", ["query", "reference"])
def test_an_object_counts_with_the_one_that_it_prefers_only(doubled: str) -> None:
    more = np.vstack([CORNERS, [20.4, 0.0, 0.0]])
    query, reference = (more, CORNERS) if doubled == "query" else (CORNERS, more)
    labels = [np.append(np.arange(6), 1)[: len(each)] for each in (query, reference)]
    found = from_near(query, labels[0], reference, labels[1], pose_at(0.05))
    np.testing.assert_allclose(found.T_reference_query, np.eye(4), atol=1e-4)


def test_objects_in_a_row_determine_yaw_the_better_the_longer_it_is() -> None:
    sigmas = []
    for length in (5.0, 50.0):
        points = np.column_stack([np.linspace(0.0, length, 8), np.zeros(8), np.zeros(8)])
        T_gt = pose_at(3.0, -8.0, z=0.5, yaw=2.5)
        found = one_to_one(points, apply(T_gt, points), T_gt)
        np.testing.assert_allclose(found.T_reference_query, T_gt, atol=1e-6)
        assert np.sqrt(found.covariance[0, 0]) == pytest.approx(TILT_SIGMA_RAD)
        sigmas.append(np.sqrt(found.covariance[2, 2]))
    assert sigmas[0] == pytest.approx(10.0 * sigmas[1], rel=0.01)


@pytest.mark.parametrize(("half_m", "is_found"), [(0.49, False), (0.54, True)])
def test_heading_is_found_if_it_is_known_to_a_fifth_of_a_radian(half_m: float, is_found: bool) -> None:
    """By four objects, whose differences err by 0.21 m; a fifth one, far off, is seen once."""
    seen = np.array([[half_m, 0, 0], [half_m, 0, 0], [-half_m, 0, 0], [-half_m, 0, 0], [30.0, 40, 0]])
    found = from_near(seen, np.arange(5), seen[:4], np.arange(4), np.eye(4))
    assert (found.T_reference_query is not None) == is_found


def test_gate_shrinks_until_objects_that_moved_are_outside() -> None:
    moved = np.concatenate([CORNERS, [[5.0, 5, 0], [15.0, 5, 0]]])
    found = one_to_one(moved, moved + [2.5, 0.0, 0.0] * (np.arange(8) > 5)[:, None], sigma_m=0.05)
    assert len(found.pairs) == 6
    np.testing.assert_allclose(found.T_reference_query, np.eye(4), atol=1e-6)


@pytest.mark.parametrize(
    ("query", "reference", "labels", "reason"),
    [
        (NONE, CORNERS, np.arange(6), "label"),
        (CORNERS, NONE, np.arange(6), "label"),
        (CORNERS[:1], CORNERS, np.arange(6), "1 pairs of objects agree on a pose, fewer than 2"),
        (CORNERS[[0, 0, 0]], CORNERS[[0, 0, 0]], np.arange(3), "heading"),
        (CORNERS, 3.0 * CORNERS, np.arange(6), "fewer than 3"),
    ],
)
def test_what_determines_nothing_has_a_reason(
    query: FloatArray, reference: FloatArray, labels: IntArray, reason: str
) -> None:
    found = from_near(query, labels[: len(query)], reference, labels[: len(reference)], np.eye(4))
    assert reason in found.reason
    assert found.T_reference_query is found.covariance is None
    assert len(found.pairs) == 0


coordinates = st.sampled_from([0.0, 1.0, 4.0, 7.5, 30.0])
points = st.lists(st.tuples(coordinates, coordinates, coordinates), min_size=0, max_size=6)


@settings(max_examples=150, deadline=None)
@given(points, points, st.sampled_from([0.1, 0.5, 8.0]))
def test_small_constellations_never_fail(
    query: list[tuple[float, ...]], reference: list[tuple[float, ...]], sigma_m: float
) -> None:
    q, r = np.reshape(query, (-1, 3)).astype(float), np.reshape(reference, (-1, 3)).astype(float)
    with np.errstate(divide="raise", invalid="raise", over="raise"):
        found = from_near(q, np.zeros(len(q)), r, np.zeros(len(r)), np.eye(4), sigma_m=sigma_m)
    assert (found.T_reference_query is None) == (found.covariance is None) == bool(found.reason)
    if found.T_reference_query is not None:
        assert np.isfinite(found.T_reference_query).all()
        assert is_one_to_one(found)
        assert len(found.pairs) >= min(len(q), 3)
        assert np.linalg.eigvalsh(found.covariance)[0] > 0.0


def test_an_inlier_that_the_last_fit_loses_is_none():
    sigmas_m = np.full(4, 0.3)
    gate_m = 3.0 * sigmas_m[0]
    corners = np.array([0.0, 20.0, 20.0j, 20.0 + 20.0j])
    moved = corners + np.array([0.0, 1.2 * gate_m, 0.0, 0.0])
    rows, flat, middle = np.column_stack([np.arange(4)] * 2), np.zeros(4), np.zeros(3)
    pairs = Pairs(rows, corners, moved, flat, flat, sigmas_m, sigmas_m, middle, middle)
    start = LevelPose(1.0, 0.25 * gate_m, 0.0)
    assert len(estimate(start, pairs, 3).pairs) == 3
    assert estimate(start, pairs, 4).reason == ("3 pairs of objects agree on a pose, fewer than 4")
