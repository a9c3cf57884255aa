"""Modes of the pose at one scan, on scenes in which the right one is known."""

import numpy as np
import pytest
from scipy.linalg import block_diag
from scipy.stats import multivariate_normal

from slam.common.arrays import FloatArray, IntArray
from slam.common.calibration import ObjectCalibration
from slam.common.geometry import apply, invert, skew, transform_from_xyz_yaw
from slam.frontend.data_association import AMBIGUOUS, MATCH_GATE, Assignment, Objects, associate, density
from slam.frontend.pose_posterior import (
    SAME_POSE_GATE,
    KnownLandmarks,
    Mode,
    ModeSearch,
    PriorComponent,
    common_error,
    is_same_pose,
    probabilities,
)
from tests.helpers.landmarks import spheres
from tests.helpers.poses import pose_at

CONFIG = ObjectCalibration()
ORIGIN = np.array([40.0, -10.0, 1.0])
AS_PREDICTED = PriorComponent(1.0, np.zeros((6, 6)))
ANYWHERE = PriorComponent(1e-4, np.diag([1e-3, 1e-3, np.pi, 50.0, 50.0, 1.0]) ** 2, is_anywhere=True)
NOTHING = Assignment(np.zeros(0, np.int64), np.zeros(0))
OWN_M, NOISE_M = 0.03, 0.03
"""What each landmark and each detection errs by, of its own."""


def by_pose(offsets: FloatArray) -> FloatArray:
    """Derivative (3 L, 6) of predicted offsets by the error of the pose, rotation first."""
    return np.concatenate([np.hstack([skew(each), -np.eye(3)]) for each in offsets])


class Scene:
    """Landmarks around a body whose pose errs by ``turn_rad`` about the vertical and ``shift_m`` along the ground."""

    def __init__(
        self, landmarks: FloatArray, *, shift_m: float = 1e-3, turn_rad: float = 1e-3, beliefs: FloatArray | None = None
    ) -> None:
        self.landmarks = ORIGIN + landmarks
        A = by_pose(landmarks)
        common = np.diag([1e-4, 1e-4, turn_rad, shift_m, shift_m, 1e-2]) ** 2
        joint = A @ common @ A.T + OWN_M**2 * np.eye(len(A))
        self.blocks = np.array([joint[row : row + 3, row : row + 3] for row in range(0, len(A), 3)])
        beliefs = np.ones((len(landmarks), 1)) if beliefs is None else beliefs
        self.known = KnownLandmarks(self.landmarks, beliefs, joint)

    def seen(self, which: IntArray, T_off: FloatArray, labels: IntArray | None = None, seed: int = 0) -> Objects:
        """Landmarks ``which``, as detected by a body that is ``T_off`` (4, 4) from where it is predicted."""
        noise = np.random.default_rng(seed).normal(scale=NOISE_M, size=(len(which), 3))
        positions = apply(invert(T_off), self.landmarks[which]) + noise
        labels = np.zeros(len(which), int) if labels is None else labels
        return Objects(positions, spheres(NOISE_M, len(which)), labels)

    def search(self, seen: Objects) -> ModeSearch:
        return ModeSearch(seen, self.known, ORIGIN, CONFIG)

    def nearest_only(self, seen: Objects) -> IntArray:
        """What each detection is by the assignment at the predicted pose."""
        return associate(seen, self.known.positions, self.blocks, self.known.beliefs, CONFIG).landmark_rows


def about_body(x: float = 0.0, y: float = 0.0, yaw: float = 0.0) -> FloatArray:
    """A motion (4, 4) of the body at ``ORIGIN``: a shift and a turn about itself."""
    at = transform_from_xyz_yaw(ORIGIN, 0.0)
    return np.asarray(at @ pose_at(x, y, yaw=yaw) @ invert(at))


def row_of_objects() -> FloatArray:
    """Offsets (14, 3) m of objects about 1 m apart, irregularly, ahead of the body."""
    rng = np.random.default_rng(5)
    x = np.arange(14) - 4.0 + rng.uniform(-0.25, 0.25, 14)
    return np.column_stack([x, 6.0 + rng.uniform(-0.25, 0.25, 14), np.zeros(14)])


def scattered(count: int = 30, seed: int = 3) -> FloatArray:
    rng = np.random.default_rng(seed)
    return np.column_stack([rng.uniform(-25.0, 25.0, (count, 2)), np.zeros(count)])


@pytest.mark.parametrize("seed", range(4))
def test_joint_shift_wins_where_nearest_landmarks_are_wrong(seed: int) -> None:
    scene, which, T_off = Scene(row_of_objects(), shift_m=0.5), np.arange(3, 10), about_body(0.7)
    seen = scene.seen(which, T_off, seed=seed)
    assert (scene.nearest_only(seen) != which).any()
    best, *others = scene.search(seen).modes([AS_PREDICTED])
    assert best.assignment.landmark_rows.tolist() == which.tolist()
    np.testing.assert_allclose(best.T_motion, T_off, atol=0.1)
    assert probabilities([best, *others])[0] > 0.99


def test_seed_of_a_pair_turns_the_body_by_what_the_landmark_shows() -> None:
    scene = Scene(scattered(), turn_rad=0.1)
    search = scene.search(scene.seen(np.arange(4), about_body(yaw=0.05)))
    xi, _ = search._seeds(search._seen, search._common)
    np.testing.assert_allclose(xi[:, 2], [0.0, 0.05, 0.05, 0.05, 0.05], atol=0.005)


@pytest.mark.parametrize("weight", [1.0, 1e-3])
def test_weight_and_covariance_of_a_mode_are_those_by_its_pairs(weight: float) -> None:
    """For errors so small that all is linear, that is a Gaussian of all differences at once."""
    scene, which = Scene(scattered(), shift_m=0.05, turn_rad=2e-3), np.array([2, 5, 9, 14])
    seen = scene.seen(which, about_body(0.04, -0.06, 2e-3))
    added = np.diag(np.repeat([1e-3, 0.03], 3)) ** 2
    (mode,) = [
        mode
        for mode in scene.search(seen).modes([PriorComponent(weight, added)])
        if mode.assignment.landmark_rows.tolist() == which.tolist()
    ]
    common, own = common_error(scene.landmarks - ORIGIN, scene.known.joint)
    A = by_pose(seen.positions - ORIGIN)
    S = A @ (common + added) @ A.T + block_diag(*(own[which] + seen.covariances))
    r = (seen.positions - scene.landmarks[which]).ravel()
    clutter = density(scene.landmarks, scene.known.joint)
    expected = multivariate_normal.logpdf(r, cov=S) - len(which) * np.log(clutter) + np.log(weight)
    assert mode.log_weight == pytest.approx(expected, abs=0.05)
    gain = (common + added) @ A.T @ np.linalg.inv(S)
    np.testing.assert_allclose(mode.covariance, (np.eye(6) - gain @ A) @ (common + added), rtol=0.01, atol=1e-8)
    np.testing.assert_allclose(probabilities([mode, mode]), 0.5)


@pytest.mark.parametrize("yaw", [np.pi / 2.0, -3.0, 0.0])
def test_wide_component_finds_any_heading(yaw: float) -> None:
    scene, which, T_off = Scene(scattered(), shift_m=0.1), np.arange(4, 16), about_body(5.0, 3.0, yaw)
    modes = scene.search(scene.seen(which, T_off)).modes([AS_PREDICTED, ANYWHERE])
    assert modes[0].component is ANYWHERE
    np.testing.assert_allclose(modes[0].T_motion, T_off, atol=0.2)
    assert modes[0].assignment.landmark_rows.tolist() == which.tolist()
    assert probabilities(modes)[0] > 0.99


@pytest.mark.parametrize(("tolerances", "count"), [(1.9, 0), (2.1, 2)])
def test_proposals_are_of_two_detections_that_their_noise_does_not_turn_by_far(tolerances: float, count: int) -> None:
    apart_m = tolerances * NOISE_M * np.sqrt(MATCH_GATE)
    scene = Scene(np.array([[5.0, 1.0, 0.0], [5.0, 1.0 + apart_m, 0.0]]))
    seen = Objects(scene.landmarks, spheres(NOISE_M, 2), np.zeros(2, int))
    assert len(scene.search(seen)._proposals()) == count


def test_wide_component_finds_nothing_where_all_objects_are_new() -> None:
    scene = Scene(scattered(), shift_m=0.1)
    new = Objects(ORIGIN + scattered(12, seed=9), spheres(NOISE_M, 12), np.zeros(12, np.int64))
    modes = scene.search(new).modes([AS_PREDICTED, ANYWHERE])
    assert modes[0].assignment.matched.sum() <= 2


def test_wide_component_is_not_sure_where_two_places_look_alike() -> None:
    """A row of objects is seen that stands at two places, one object of it at one of them only."""
    row = np.array([[x, 0.0, 0.0] for x in (0.0, 3.0, 5.0, 9.0, 10.0, 14.0, 16.0)])
    landmarks = np.concatenate([row - [8.0, 15.0, 0.0], row[:6] - [8.0, -15.0, 0.0]])
    scene, T_off = Scene(landmarks, shift_m=0.1), about_body(0.0, -8.0, 0.5)
    modes = scene.search(scene.seen(np.arange(7), T_off)).modes([AS_PREDICTED, ANYWHERE])
    found = [mode for mode in modes if mode.assignment.matched.any()]
    assert [mode.assignment.matched.sum() for mode in found[:2]] == [7, 6]
    assert found[0].log_weight - found[1].log_weight > np.log(99.0)
    assert probabilities(modes)[modes.index(found[0])] < 0.99


def test_labels_decide_between_places_that_look_alike() -> None:
    """The same three objects stand in two places; in one of them their classes are others."""
    shape = np.array([[0.0, 0.0, 0.0], [3.0, 1.0, 0.0], [1.0, 4.0, 0.0]])
    away = np.array([10.0, 0.0, 0.0])
    landmarks = np.concatenate([shape - away, shape + away, scattered(10)])
    labels = np.array([0, 1, 2, 3, 4, 5, *range(6, 16)])
    beliefs = 0.98 * np.eye(20)[labels] + 0.001
    scene, which, T_off = Scene(landmarks, beliefs=beliefs), np.array([3, 4, 5]), about_body(10.0, 0.0, 0.0)
    modes = scene.search(scene.seen(which, T_off, labels[which])).modes([ANYWHERE])
    assert modes[0].assignment.landmark_rows.tolist() == which.tolist()
    assert probabilities(modes)[0] > 0.99


def test_detection_that_may_be_bad_has_no_mode_of_its_own() -> None:
    """Outside the gate of its landmark, but not as far off as a new object."""
    scene = Scene(row_of_objects())
    seen = scene.seen(np.array([3]), np.eye(4))
    seen.positions[0, 2] += 0.2
    assert scene.nearest_only(seen).tolist() == [AMBIGUOUS]
    assert len(scene.search(seen).modes([AS_PREDICTED])) == 1


@pytest.mark.filterwarnings("error")
def test_a_scan_without_detections_or_pairs_of_them_has_one_mode() -> None:
    scene = Scene(scattered())
    assert len(scene.search(scene.seen(np.array([3]), np.eye(4))).modes([ANYWHERE])) == 1
    (mode,) = scene.search(scene.seen(np.zeros(0, dtype=np.int64), np.eye(4))).modes([ANYWHERE])
    assert mode.log_weight == np.log(ANYWHERE.weight)
    np.testing.assert_array_equal(mode.T_motion, np.eye(4))
    assert not mode.assignment.matched.any()


@pytest.mark.parametrize("share", [0.0, 0.5, 1.0])
def test_is_same_pose_within_the_gate_of_shift_and_turn_together(share: float) -> None:
    for factor in (0.99, 1.01):
        shift, turn = np.sqrt([share, 1.0 - share]) * np.sqrt(factor * SAME_POSE_GATE) * [0.1, 0.01]
        modes = [
            Mode(T, 0.5 * np.diag(np.repeat([0.01, 0.1], 3)) ** 2, AS_PREDICTED, 0.0, NOTHING)
            for T in (pose_at(shift, yaw=turn), np.eye(4))
        ]
        assert is_same_pose(*modes) == (factor < 1.0)


@pytest.mark.parametrize(("shift_m", "is_uncertain"), [(0.5, True), (0.005, False)])
def test_pose_is_uncertain_if_landmarks_share_most_of_their_error(shift_m: float, is_uncertain: bool) -> None:
    scene = Scene(scattered(), shift_m=shift_m, turn_rad=1e-4)
    assert scene.search(scene.seen(np.arange(6), np.eye(4))).is_pose_uncertain is is_uncertain


def test_pure_pose_error_is_common_and_leaves_none_of_its_own() -> None:
    offsets = scattered(12)
    offsets[:, 2] += np.random.default_rng(0).normal(scale=2.0, size=12)
    L = np.random.default_rng(1).normal(size=(6, 6)) * np.repeat([0.01, 0.3], 3)[:, None]
    A = by_pose(offsets)
    common, own = common_error(offsets, A @ L @ L.T @ A.T)
    np.testing.assert_allclose(common, L @ L.T, atol=1e-5)
    np.testing.assert_allclose(own, 0.0, atol=1e-9)


def test_errors_of_landmarks_alone_stay_their_own_but_for_what_they_share_by_chance() -> None:
    """Of the 3 L errors, a motion explains six."""
    offsets = scattered(20)
    offsets[:, 2] += np.random.default_rng(0).normal(scale=2.0, size=20)
    _, own = common_error(offsets, 0.04 * np.eye(60))
    assert np.trace(own, axis1=1, axis2=2).sum() == pytest.approx(0.04 * (60 - 6))
    assert np.linalg.eigvalsh(own).min() > 0.0
