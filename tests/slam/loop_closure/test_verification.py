"""Verification without a drive: what is refused, the relative pose and its covariance, and what is compared with it."""

from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from slam.common.arrays import FloatArray, IntArray
from slam.common.config import Config
from slam.common.geometry import apply, covariance_in_axes, gravity_frame, invert, yaw_rad
from slam.loop_closure import verification
from slam.loop_closure.candidate import Candidate, Query
from slam.loop_closure.likelihood_ratio import DETECTION_PROBABILITY
from slam.loop_closure.verification import CLOSURE_SIGMA_RAD, Verifier
from slam.object_map.submap import Submap
from slam.odometry.keyframe import Keyframe
from slam.odometry.noise import SLIP_INFLATION
from slam.place_recognition.place_search import Place
from slam.registration.registration import search_radius_m
from tests.helpers.candidates import make_candidate
from tests.helpers.poses import keyframe_at, motion_by, pose_at
from tests.slam.loop_closure.doubles import make_keyframe, make_query, make_submap

STEP_M = 2.0
ROUND = 90
"""Keyframes of the first round; those after it stand where the first ones stood."""
HERE = 20
QUERY = ROUND + HERE
ROLL_PITCH = {HERE: (0.06, -0.1), QUERY: (-0.12, 0.08)}


def body(number: int) -> FloatArray:
    """The body leans at the two keyframes that are compared."""
    upright = pose_at(STEP_M * (number % ROUND), yaw=0.3)
    roll, pitch = ROLL_PITCH.get(number, (0.0, 0.0))
    return upright @ motion_by([roll, pitch, 0.0])


def make_keyframes(*, second_segment: int = 0) -> list[Keyframe]:
    found = []
    for number in range(ROUND + 40):
        segment = second_segment if number >= ROUND else 0
        found.append(keyframe_at(body(number), number, travel_m=STEP_M * number, segment=segment))
    return found


class Landmarks:
    """A retriever that knows what stands around every place."""

    def __init__(self, reference: Submap) -> None:
        self.reference = reference
        self.repeated = [np.eye(4)]

    def reference_submap(self, place: Place, *, before_m: float) -> Submap:
        return self.reference

    def class_shares(self) -> FloatArray:
        return np.full(16, 1.0 / 16.0)

    def self_similar_poses(self, query: Submap) -> FloatArray:
        return np.stack(self.repeated)


class Scene:
    """Objects around a keyframe of the first round, seen again from the same place on the second one."""

    def __init__(self, objects: FloatArray, *, second_segment: int = 0, **settings: Any) -> None:
        self.config = Config.model_validate(settings)
        self.keyframes = make_keyframes(second_segment=second_segment)
        world = objects + np.array([STEP_M * HERE, 0.0, 0.0])
        self.landmarks = Landmarks(make_submap(world, first_row=0))
        self.verifier = self.make_verifier()
        T_local_gravity = gravity_frame(self.keyframes[QUERY].T_local_body)
        seen = make_submap(apply(invert(T_local_gravity), world), first_row=500)
        before_m = STEP_M * QUERY - self.config.closure_travel_m
        self.query = Query(self.keyframes[QUERY], seen, T_local_gravity, before_m)
        self.place = Place(T_local_gravity, STEP_M * HERE, 0, "descriptor")

    def make_verifier(
        self,
        pose: Callable[[int], FloatArray] | None = None,
        observed_positions: Callable[[IntArray], FloatArray] | None = None,
    ) -> Verifier:
        """Where the graph has the keyframes where the odometry has them, unless ``pose`` tells others."""
        pose = pose or (lambda number: self.keyframes[number].odometry.T_odom_body)
        return Verifier(self.config, self.landmarks, self.keyframes, pose, observed_positions)  # type: ignore[arg-type]

    def verified(self, place: Place | None = None) -> Candidate:
        found = self.verifier.verify(self.query, place or self.place)
        assert isinstance(found, Candidate), found.reason
        return found

    def refusal(self, place: Place | None = None) -> str:
        found = self.verifier.verify(self.query, place or self.place)
        assert not isinstance(found, Candidate)
        assert found.proposer == "descriptor"
        return found.reason


def scattered() -> FloatArray:
    return np.random.default_rng(5).uniform([-20.0, -15.0, -1.0], [20.0, 15.0, 1.0], (12, 3))


def test_the_relative_pose_is_that_of_the_bodies_tilt_included():
    found = Scene(scattered()).verified()
    assert (found.query.id, found.reference.id) == (QUERY, HERE)
    np.testing.assert_allclose(found.T_reference_query, invert(body(HERE)) @ body(QUERY), atol=1e-6)
    assert len(found.pairs) == 12


@pytest.mark.parametrize(("moved_m", "is_moved"), [(6.0, True), (0.3, False)])
def test_the_graph_tells_where_landmarks_are_that_have_moved_in_the_local_map(moved_m, is_moved):
    scene = Scene(scattered())
    seen = scene.landmarks.reference.positions
    T_map_local = pose_at(3.0, -2.0, yaw=0.7)
    # The graph has its own frame, in which the keyframe is where the landmarks were when it saw them.
    scene.verifier = scene.make_verifier(
        pose=lambda number: T_map_local @ body(number), observed_positions=lambda rows: apply(T_map_local, seen[rows])
    )
    T_moved = pose_at(moved_m, -0.5 * moved_m, yaw=0.02 * moved_m)
    scene.landmarks.reference = replace(scene.landmarks.reference, positions=apply(T_moved, seen))
    found = scene.verified(replace(scene.place, T_local_query=T_moved @ scene.place.T_local_query))
    expected = body(QUERY) if is_moved else T_moved @ body(QUERY)
    np.testing.assert_allclose(found.T_reference_query, invert(body(found.reference.id)) @ expected, atol=1e-6)


def test_landmarks_that_the_graph_has_not_seen_are_where_the_local_map_has_them():
    scene = Scene(scattered())
    scene.verifier = scene.make_verifier(
        pose=lambda number: pose_at(50.0) @ body(number),
        observed_positions=lambda rows: np.where(rows[:, None] == 3, np.nan, 0.0) + np.zeros(3),
    )
    np.testing.assert_allclose(scene.verified().T_reference_query, invert(body(HERE)) @ body(QUERY), atol=1e-6)


def test_reach_is_the_sum_of_search_radii_that_halve():
    scene = Scene(scattered())
    radii_m = search_radius_m(scene.config) * 0.5 ** np.arange(60)
    assert scene.verifier.reach_m == pytest.approx(radii_m.sum())


def test_where_a_query_cannot_be_registered_no_object_has_a_match():
    scene = Scene(scattered())
    ratios = scene.verifier.unmatched(scene.query, scene.place)
    np.testing.assert_allclose(ratios, np.log1p(-DETECTION_PROBABILITY))
    far = replace(scene.place, T_local_query=pose_at(900.0))
    np.testing.assert_array_equal(scene.verifier.unmatched(scene.query, far), 0.0)


@pytest.mark.parametrize(("lateral_m", "is_verified"), [(25.0, True), (35.0, False)])
def test_a_way_beside_the_traversal_is_verified_within_the_range_of_the_sensor(lateral_m, is_verified):
    scene = Scene(scattered())
    aside = pose_at(0.0, lateral_m)
    scene.landmarks.reference = make_submap(apply(aside, scene.landmarks.reference.positions))
    place = replace(scene.place, T_local_query=aside @ scene.place.T_local_query)
    if is_verified:
        assert len(scene.verified(place).pairs) >= 3
    else:
        assert "no earlier keyframe within 30 m of the place" in scene.refusal(place)


def test_the_reference_is_no_keyframe_of_the_same_traversal():
    scene = Scene(scattered())
    assert "no earlier keyframe" in scene.refusal(replace(scene.place, travel_m=STEP_M * QUERY, T_local_query=(
        scene.place.T_local_query)))  # fmt: skip


def test_a_closure_predicts_within_its_segment():
    scene = Scene(scattered())
    seed = make_candidate(
        query=scene.keyframes[QUERY - 5],
        reference=scene.keyframes[HERE - 5],
        T_local_query=gravity_frame(body(QUERY - 5)),
    )
    place = scene.verifier.predict(seed, scene.query)
    np.testing.assert_allclose(place.T_local_query, gravity_frame(body(QUERY)), atol=1e-9)
    assert (place.travel_m, place.predicted_by) == (STEP_M * HERE, QUERY - 5)
    elsewhere = replace(scene.query, keyframe=replace(scene.query.keyframe, odometry=replace(
        scene.query.keyframe.odometry, segment=1)))  # fmt: skip
    assert scene.verifier.predict(seed, elsewhere) is None


def test_the_errors_that_inliers_share_are_in_the_covariance_in_the_axes_of_the_body(monkeypatch):
    tilt, yaw = np.deg2rad([20.0, 5.0])
    found = []
    for objects, angles in (
        ({"landmark_sigma_m": 1.0, "landmark_height_sigma_m": 2.0}, (tilt, yaw)),
        ({"landmark_sigma_m": 1e-6}, (1e-6, 1e-6)),
    ):
        monkeypatch.setattr(verification, "TILT_SIGMA_RAD", angles[0])
        monkeypatch.setattr(verification, "CLOSURE_SIGMA_RAD", angles[1])
        found.append(Scene(scattered(), calibration={"objects": objects}).verified())
    with_shared, without = found
    upright = np.diag([tilt**2, tilt**2, yaw**2, 1.0, 1.0, 5.0])
    R_gravity_body = (invert(gravity_frame(body(QUERY))) @ body(QUERY))[:3, :3]
    expected = covariance_in_axes(upright, R_gravity_body)
    np.testing.assert_allclose(with_shared.covariance - without.covariance, expected, atol=1e-6)


def test_the_penalty_is_that_of_the_prior_which_is_uniform_across_a_break():
    near, across = Scene(scattered()).verified(), Scene(scattered(), second_segment=1).verified()
    assert near.odometry_penalty < near.unpredicted_penalty
    assert across.odometry_penalty == across.unpredicted_penalty == pytest.approx(near.unpredicted_penalty, abs=1.0)


def test_a_pattern_that_repeats_itself_is_another_pose():
    """A square: the same again after a quarter turn."""
    scene = Scene(np.array([[6.0, 6.0, 0.0], [-6.0, 6.0, 0.0], [-6.0, -6.0, 0.0], [6.0, -6.0, 0.0]]))
    best = scene.verified()
    assert scene.verifier.rivals(scene.query, best) == []
    scene.landmarks.repeated.append(pose_at(yaw=np.pi / 2.0))
    (other,) = scene.verifier.rivals(scene.query, best)
    turn_rad = float(yaw_rad(invert(best.T_local_query) @ other.T_local_query))
    assert abs(turn_rad) == pytest.approx(np.pi / 2.0, abs=1e-3)


def test_landmarks_that_are_not_confirmed_speak_for_a_pose_and_are_not_merged():
    scene = Scene(scattered())
    existence = np.r_[np.ones(8), np.full(4, 0.6)]
    without = scene.query.submap.of(existence == 1.0)
    scene.query = replace(scene.query, submap=replace(scene.query.submap, existence=existence))
    found = scene.verified()
    assert sorted(found.pairs[:, 0].tolist()) == without.rows.tolist()
    scene.query = replace(scene.query, submap=without)
    assert found.log_likelihood_ratio > scene.verified().log_likelihood_ratio + 4.0


# How far the odometry may err

CONFIG = Config()
PLACE = Place(pose_at(7.0), 0.0, 0, "descriptor")
STREET = [make_keyframe(number, STEP_M * number) for number in range(100)]
LATEST = make_query(STREET[-1])


def along_street(*, bent_m: float = 0.0, mapped: Sequence[FloatArray] = ()) -> Verifier:
    """In whose graph the poses from the middle of the street on are ``bent_m`` farther on."""

    def pose(id: int) -> Any:
        return pose_at(STREET[id].odometry.travel_m + (bent_m if 2 * id > len(STREET) else 0.0))

    nothing = Landmarks(make_submap(np.zeros((0, 3))))
    return Verifier(CONFIG, nothing, STREET, pose, mapped=mapped)  # type: ignore[arg-type]


def test_a_prior_follows_the_graph_from_the_reference_or_else_the_closure():
    verifier = along_street(bent_m=5.0)
    followed = verifier._prior(LATEST, PLACE, STREET[3])
    np.testing.assert_allclose(followed.T_local_query, pose_at(STREET[-1].odometry.travel_m + 5.0), atol=1e-12)
    predicted = verifier._prior(LATEST, replace(PLACE, predicted_by=20), STREET[3])
    np.testing.assert_array_equal(predicted.T_local_query, PLACE.T_local_query)


@pytest.mark.parametrize("since", [3, 60])
def test_a_prior_is_as_wide_as_the_odometry_may_have_drifted_since(since):
    verifier = along_street()
    sigma_m, sigma_rad = verifier.track.drift_sigmas(since, LATEST.keyframe.id)
    landmark_sigma_m = CONFIG.calibration.objects.landmark_sigma_m
    for prior in (
        verifier._prior(LATEST, PLACE, STREET[since]),
        verifier._prior(LATEST, replace(PLACE, predicted_by=since), STREET[0]),
    ):
        assert prior.sigma_m == pytest.approx(np.hypot(SLIP_INFLATION * sigma_m, landmark_sigma_m))
        assert prior.sigma_rad == pytest.approx(np.hypot(SLIP_INFLATION * sigma_rad, CLOSURE_SIGMA_RAD))
        travel_m = STREET[-1].odometry.travel_m - STEP_M * since
        assert prior.failure_probability == CONFIG.localization.failure_probability(travel_m)


def test_a_prior_is_spread_over_cells_of_keyframes_and_of_objects_of_maps_without_any():
    mapped = np.array([[1.0, 1.0], [2.0, 2.0], [31.0, 1.0], [1.0, 31.0]])
    prior = along_street(mapped=[mapped, mapped])._prior(LATEST, PLACE, STREET[3])
    assert prior.area_m2 == (7 + 2 * 3) * CONFIG.sensor_range_m**2
