"""Noise of odometry and detections: simulated with known size, and estimated."""

from dataclasses import astuple, replace

import numpy as np
import pytest

from slam.common.geometry import view_change
from slam.odometry.noise import FREEDOM
from slam.self_calibration import variance_components
from slam.self_calibration.object_tracks import ObjectTracks, follow_objects, objects_among
from slam.self_calibration.variance_components import (
    BLOCKS,
    OWN,
    SHARED,
    ComponentEstimate,
    Motion,
    NoiseComponents,
    _axes,
    _Displacements,
    _displacements,
    _Fit,
    _jacobians,
    _lagged_pairs,
    _own_parts,
    _shared_parts,
    _weights,
    estimate_components,
)
from tests.helpers.surveyed_drives import SurveyedDrive, tracks_of

DETECTOR = {"radial": 0.05, "tangential": 0.05}
"""Standard deviations [m] that are there in every drive."""


NAMES = {
    2: "radial tangential height view view_height jitter translation_by_time rise",
    1: "translation_by_travel rise_by_travel",
    0: "radial_by_range tangential_by_range heading_jitter heading_by_turn heading_by_time stamps tilt_jitter",
    -1: "heading_by_travel tilt_by_travel",
}
POWERS = {name: power for power, names in NAMES.items() for name in names.split()}
"""With which power of the length each variance scales."""


@pytest.fixture
def few_pairs(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(variance_components, "USED_PAIRS", 1000)


def estimate(drive: SurveyedDrive) -> ComponentEstimate:
    found = estimate_components(drive.tracks, drive.motion)
    assert found is not None
    return found


@pytest.mark.parametrize(
    "sigmas",
    [
        {"view": 0.1, "translation_by_travel": 0.05, "heading_by_turn": 0.03},
        {"tangential": 0.1, "radial_by_range": 0.02, "jitter": 0.05, "heading_by_time": 0.01},
        {"tangential_by_range": 0.02, "heading_jitter": 0.01, "translation_by_time": 0.05},
        {"radial": 0.1, "view": 0.2, "heading_by_travel": 0.01},
        {"stamps": 0.04, "translation_by_travel": 0.05, "heading_by_turn": 0.01},
    ],
)
def test_components_are_found_and_told_apart(sigmas: dict[str, float]) -> None:
    sigmas = DETECTOR | sigmas
    found = estimate(SurveyedDrive(0, sigmas)).variances
    for name, sigma in sigmas.items():
        assert sigma / 1.5 < np.sqrt(getattr(found, name)) < sigma * 1.5, name


@pytest.mark.usefixtures("few_pairs")
@pytest.mark.parametrize("scale", [0.01, 1000.0])
def test_estimates_scale_with_all_lengths(scale):
    sigmas = DETECTOR | {"view": 0.1, "jitter": 0.03, "translation_by_travel": 0.05, "heading_by_turn": 0.02}
    small, large = (estimate(SurveyedDrive(1, sigmas, scale=factor)) for factor in (1.0, scale))
    assert set(POWERS) == set(NoiseComponents.__dataclass_fields__)
    for name, power in POWERS.items():
        floor = 1e-4 * scale**power  # a hundredth of the detector's [m], or less
        expected = getattr(small.variances, name) * scale**power
        assert getattr(large.variances, name) == pytest.approx(expected, rel=0.05, abs=floor), name
        expected = getattr(small.standard_errors, name) * scale**power
        assert getattr(large.standard_errors, name) == pytest.approx(expected, rel=0.3, abs=floor), name
    assert large.pairs == small.pairs


def test_a_few_wrong_matches_and_moving_objects_change_little():
    sigmas = DETECTOR | {"translation_by_travel": 0.05}
    drive = SurveyedDrive(0, sigmas)
    tracks = drive.tracks
    wrong = np.random.default_rng(0).random(len(tracks.track)) < 0.005
    shift = np.where(wrong[:, None], 5.0, 0.0) * [1.0, -1.0]
    spoilt = estimate_components(
        replace(tracks, points=tracks.points + shift, offsets=tracks.offsets + shift), drive.motion
    )
    for name, sigma in sigmas.items():
        assert sigma / 1.5 < np.sqrt(getattr(spoilt.variances, name)) < sigma * 1.5, name


@pytest.mark.parametrize("count", [0, 1, 60])
def test_too_few_detections_tell_nothing(count):
    tracks = tracks_of(np.zeros(count, int), np.arange(count), np.ones((count, 2)), np.ones((count, 2)))
    times = np.arange(float(count))
    assert estimate_components(tracks, Motion(times, times, times, times)) is None


def test_pairs_are_ever_twice_as_many_detections_apart_while_there_are_enough():
    track = tracks_of(np.zeros(300, int), np.arange(300), np.ones((300, 2)), np.ones((300, 2)))
    lags = [np.unique(second - first).tolist() for first, second in _lagged_pairs(track)]
    assert lags == [[1], [2], [4], [8], [16], [32], [64], [128]]


@pytest.mark.filterwarnings("error")
def test_a_log_without_any_noise_has_none() -> None:
    found = estimate(SurveyedDrive(0, {}, scans=300, objects=30, turns=False))
    assert np.isfinite(astuple(found.variances)).all()


def test_noise_of_half_the_spacing_is_no_bias_of_the_view() -> None:
    drive = SurveyedDrive(0, {"radial": 0.5, "tangential": 0.5}, objects=60)
    found = estimate_components(follow_objects(drive.scans), drive.motion)
    assert 0.5 / 1.5 < np.sqrt(0.5 * (found.variances.radial + found.variances.tangential)) < 0.5 * 1.5
    assert np.sqrt(found.variances.view) < 0.25


@pytest.mark.parametrize("scale", [1e154, 1e200, 1e300])
def test_absurd_distances_tell_nothing(scale):
    drive = SurveyedDrive(0, {"radial": 0.1}, scans=60, objects=40)
    far = replace(drive.tracks, offsets=scale * drive.tracks.offsets, points=scale * drive.tracks.points)
    with np.errstate(all="ignore"):
        assert estimate_components(far, drive.motion) is None


@pytest.mark.usefixtures("few_pairs")
def test_scans_of_nonsense_in_an_exact_log_make_no_matrix_singular() -> None:
    drive, rng = SurveyedDrive(2, {}, scans=600, objects=80), np.random.default_rng(0)
    scans = list(drive.scans)
    for number in range(200, 600, 13):
        anywhere = rng.uniform(-30.0, 30.0, scans[number].positions.shape) * [1.0, 1.0, 0.05]
        scans[number] = replace(scans[number], positions=anywhere)
    assert estimate_components(objects_among(follow_objects(scans)), drive.motion) is not None


def test_component_that_stays_at_zero_is_not_known_exactly() -> None:
    """The jackknife sees no spread in it, but the displacements tell only so much."""
    found = estimate(SurveyedDrive(0, DETECTOR, scans=400))
    of_heights = {"height", "view_height", "rise", "rise_by_travel", "tilt_jitter", "tilt_by_travel"}
    for name in set(POWERS) - of_heights:
        assert getattr(found.standard_errors, name) > 0.0, name
    for name in of_heights:
        assert getattr(found.variances, name) == getattr(found.standard_errors, name) == 0.0, name


@pytest.mark.usefixtures("few_pairs")
def test_a_motion_that_never_was_tells_nothing_of_its_noise():
    drive = SurveyedDrive(0, DETECTOR, scans=400)
    found = estimate_components(
        drive.tracks, replace(drive.motion, heading_rad=np.zeros_like(drive.motion.heading_rad))
    )
    assert found.variances.heading_by_turn == found.standard_errors.heading_by_turn == 0.0


def tilting(*, tilt: float, rise: float, height: float) -> tuple[ObjectTracks, Motion]:
    """A drive with heights: an odometry that tilts and rises at random by travel, detections with noise of height."""
    drive, rng = SurveyedDrive(0, DETECTOR), np.random.default_rng(0)
    tracks, motion = drive.tracks, drive.motion
    steps = np.sqrt(np.diff(motion.travel_m, prepend=0.0))
    tilts = np.cumsum(tilt * steps[:, None] * rng.normal(size=(len(steps), 2)), axis=0)
    rises = np.cumsum(rise * steps * rng.normal(size=len(steps)))
    objects = rng.normal(0.0, 2.0, tracks.track.max() + 1)[tracks.track]
    heights = objects + np.einsum("ni,ni->n", tilts[tracks.scan], tracks.offsets) + rises[tracks.scan]
    heights += rng.normal(0.0, height, len(heights))
    return replace(tracks, heights=heights), replace(motion, height_m=np.zeros(len(steps)))


def test_heights_count_from_the_body() -> None:
    """On a mountain they are what they are at sea level."""
    tracks, motion = tilting(tilt=0.01, rise=0.1, height=0.1)
    body_m = np.linspace(90.0, 110.0, len(motion.time_s))
    low = _displacements(tracks, motion)
    high = _displacements(
        replace(tracks, heights=tracks.heights + body_m[tracks.scan]), replace(motion, height_m=body_m)
    )
    for name in ("x", "x_before"):
        np.testing.assert_allclose(getattr(high, name), getattr(low, name), atol=1e-9)


def test_noise_of_single_detections_adds_up_along_and_across_the_second_ray() -> None:
    """A displacement has the noise of both detections; the first one's axes are turned against the second's."""
    rng = np.random.default_rng(0)
    x, x_before = (np.column_stack([rng.uniform(-20.0, 20.0, (50, 2)), np.zeros(50)]) for _ in range(2))
    heights = np.column_stack([np.zeros((50, 2)), np.ones(50)])
    still = _Displacements(
        heights, x, x_before, np.zeros(50, np.int64), np.zeros((1, 3)), np.zeros((1, 2)), np.zeros(1), 1.0
    )
    parts = iter(_own_parts(still))
    axes, axes_before = _axes(still), _axes(replace(still, x=x_before))
    squares = [np.sum(each**2, axis=1)[:, None] for each in (x, x_before)]
    for sigmas in ([1.0, 0.0, 0.0], [0.0, 1.0, 0.0]):  # along the ray, and across it, which says nothing of heights
        noise = [np.diag(sigmas) @ axes, np.diag(sigmas) @ axes_before]
        after, before = (np.sum((axes @ each.transpose(0, 2, 1)) ** 2, axis=2) for each in noise)
        np.testing.assert_allclose(next(parts), after + before, atol=1e-9)
        np.testing.assert_allclose(next(parts), after * squares[0] + before * squares[1], atol=1e-9)


def displacements() -> _Displacements:
    """Of eleven objects between three pairs of scans, in two of the blocks of a log."""
    rng = np.random.default_rng(0)
    d, x, x_before = rng.uniform(-20.0, 20.0, (3, 11, 3))
    group, moved, rates = np.repeat([0, 1, 2], [2, 5, 4]), rng.random((3, 3)), rng.random((3, 2))
    return _Displacements(d, x, x_before, group, moved, rates, np.array([0, 2, 2]), 1.0)


def test_sums_of_a_fit_are_those_of_the_dense_covariance_of_all_displacements() -> None:
    fit, rng = _Fit(displacements()), np.random.default_rng(0)
    fit.variances = rng.random(OWN + SHARED)
    expected, information = np.zeros((2, OWN + SHARED, BLOCKS)), np.zeros(OWN + SHARED)
    for group, block in enumerate([0, 2, 2]):
        rows = fit._pairs.group == group
        A, y = fit._A[rows].reshape(-1, 7), fit._y[rows].ravel()
        own, shared = fit._parts[0][:, rows].reshape(OWN, -1), fit._parts[1][:, group]
        V = np.array([*(np.diag(each) for each in own), *(A * each @ A.T for each in shared)])
        inverse = np.linalg.inv(np.tensordot(fit.variances, V, 1))
        expected[0, :, block] += inverse @ y @ V @ inverse @ y
        expected[1, :, block] += np.trace(inverse @ V, axis1=1, axis2=2)
        information[:OWN] += 0.5 * np.sum((own * np.diag(inverse)) ** 2, axis=1)
        information[OWN:] += 0.5 * np.sum((shared * np.diag(A.T @ inverse @ A)) ** 2, axis=1)
    np.testing.assert_allclose(fit._sums(), expected)
    np.testing.assert_allclose(fit._held_errors, information**-0.5)


def test_standard_errors_are_those_of_an_iteration_without_one_block_at_a_time(monkeypatch) -> None:
    fit, sums = _Fit(displacements()), np.random.default_rng(1).random((2, OWN + SHARED, BLOCKS))
    fit._held_errors = np.zeros(OWN + SHARED)
    monkeypatch.setattr(fit, "_sums", lambda: sums)
    fitted, expected = np.array([np.delete(sums, block, axis=2).sum(axis=2) for block in range(BLOCKS)]).swapaxes(0, 1)
    jackknife = np.sqrt(BLOCKS - 1) * np.std(fitted / expected, axis=0)
    np.testing.assert_allclose(fit.standard_errors(), fit.variances * jackknife)


def test_jacobians_turn_and_shift_objects_half_way_and_shift_them_across_the_motion() -> None:
    pairs, xi = displacements(), np.array([0.1, -0.2, 0.3, 1.0, 2.0, 3.0, 0.5])
    across = (pairs.x - pairs.x_before)[:, [1, 0, 2]] * [-1.0, 1.0, 0.0]
    expected = np.cross(xi[:3], 0.5 * (pairs.x + pairs.x_before)) + xi[3:6] + xi[6] * across
    np.testing.assert_allclose(_jacobians(pairs) @ xi, expected)


def test_own_parts_change_with_the_view_by_no_more_than_the_travel_explains() -> None:
    pairs = displacements()
    ranges = np.sqrt(np.linalg.norm(pairs.x, axis=1) * np.linalg.norm(pairs.x_before, axis=1))
    changes = np.minimum(view_change(pairs.x_before, pairs.x), pairs.moved[pairs.group, 0] / ranges)
    np.testing.assert_allclose(_own_parts(pairs)[5:], np.array([[[1, 1, 0]], [[0, 0, 1]]]) * changes[:, None])


def test_shared_parts_are_errors_at_both_ends_and_by_travel_turn_and_time() -> None:
    """Those of the heading that grow on the way also shift objects, by a twelfth of the square."""
    pairs = displacements()
    L, A, T = pairs.moved.T
    expected = np.zeros((3, SHARED, 7))
    expected[:, :3, 3] = expected[:, :3, 4] = np.column_stack([L * 0.0 + 2.0, L, T])
    expected[:, 3:5, 5] = expected[:, 10:, 0] = expected[:, 10:, 1] = expected[:, :2, 3]
    expected[:, 9, 2], expected[:, 9, 3:5] = pairs.rates[:, 1], pairs.rates[:, :1] / 2.0
    expected[:, 5:9, 2] = np.column_stack([expected[:, :2, 3], A, T])
    expected[:, 5:9, 6] = expected[:, 5:9, 2] * [1.0 / 4.0, 1.0 / 12.0, 1.0 / 12.0, 1.0 / 12.0]
    np.testing.assert_allclose(_shared_parts(pairs), expected.swapaxes(0, 1))


@pytest.mark.parametrize("size", [2, 7])
def test_weights_of_gaussian_errors_are_one_in_the_mean(size: int) -> None:
    squares = np.random.default_rng(0).chisquare(size, 100_000)
    assert np.mean(_weights(squares, size) * squares) == pytest.approx(size, rel=0.01)
    near, far = _weights(np.array([0.0, 100.0]), size)
    assert near / far == pytest.approx(1.0 + 100.0 / FREEDOM)


def test_noise_across_the_ray_is_found_where_heights_are_exact() -> None:
    """As those of detections that are projected to the ground."""
    drive = SurveyedDrive(0, {"radial": 0.05, "tangential": 0.2})
    rng = np.random.default_rng(0)
    heights = rng.normal(scale=1e-3, size=len(drive.tracks.heights))
    found = estimate_components(replace(drive.tracks, heights=heights), drive.motion)
    assert 0.2 / 1.5 < np.sqrt(found.variances.tangential) < 0.2 * 1.5
    assert np.sqrt(found.variances.height) < 0.01


@pytest.mark.usefixtures("few_pairs")
@pytest.mark.parametrize(("name", "sigma"), [("tilt_by_travel", 0.01), ("rise_by_travel", 0.1), ("height", 0.3)])
def test_noise_of_heights_is_told_apart(name: str, sigma: float) -> None:
    given = {"tilt_by_travel": 0.001, "rise_by_travel": 0.01, "height": 0.05} | {name: sigma}
    found = estimate_components(
        *tilting(tilt=given["tilt_by_travel"], rise=given["rise_by_travel"], height=given["height"])
    )
    assert sigma / 2.0 < np.sqrt(getattr(found.variances, name)) < sigma * 2.0


def test_heights_of_a_few_faulty_scans_of_a_planar_sensor_change_no_other_noise() -> None:
    sigmas = DETECTOR | {"translation_by_travel": 0.05}
    drive, rng = SurveyedDrive(0, sigmas), np.random.default_rng(0)
    for scan in drive.scans[600:720]:
        scan.positions[:] = rng.uniform(-30.0, 30.0, scan.positions.shape) * [1.0, 1.0, 0.3]
    found = estimate_components(follow_objects(drive.scans), drive.motion)
    for name, sigma in sigmas.items():
        assert sigma / 1.5 < np.sqrt(getattr(found.variances, name)) < 1.5 * sigma
    assert 0.05 < np.sqrt(found.variances.height) < 1.0  # uniform within 9 m in the faulty scans
