"""Priors of the poses of queries: how far the odometry may err."""

from __future__ import annotations

from dataclasses import replace
from typing import Any, cast

import numpy as np
import pytest

from slam.common.config import Config
from slam.localization.pose_prior import failure_probability
from slam.loop_closure.candidate import Query
from slam.loop_closure.verification import CLOSURE_SIGMA_RAD, Verifier
from slam.odometry.keyframe import Keyframe
from slam.odometry.noise import SLIP_INFLATION
from slam.place_recognition.place import Place
from slam.place_recognition.retrieval import PlaceRetriever
from tests.helpers.poses import pose_at
from tests.slam.loop_closure.doubles import make_keyframe, make_query

CONFIG = Config()
STEP_M = 2.0
COUNT = 100
LATEST_M = STEP_M * (COUNT - 1)
PLACE = Place(pose_at(7.0), 0.0, 0, "descriptor")


def make_priors(keyframes: list[Keyframe], *, bent_m: float = 0.0) -> Verifier:
    """In whose graph the poses from the middle of the drive on are ``bent_m`` farther on."""

    def pose(id: int) -> Any:
        return pose_at(keyframes[id].odometry.travel_m + (bent_m if 2 * id > COUNT else 0.0))

    return Verifier(CONFIG, cast(PlaceRetriever, None), keyframes, pose)


@pytest.fixture
def keyframes() -> list[Keyframe]:
    return [make_keyframe(number, STEP_M * number) for number in range(COUNT)]


@pytest.fixture
def query(keyframes: list[Keyframe]) -> Query:
    return make_query(keyframes[-1])


def test_a_prior_follows_the_graph_from_the_reference_or_else_the_closure(
    keyframes: list[Keyframe], query: Query
) -> None:
    priors = make_priors(keyframes, bent_m=5.0)
    followed = priors._prior(query, PLACE, keyframes[3])
    np.testing.assert_allclose(followed.T_local_query, pose_at(LATEST_M + 5.0), atol=1e-12)
    predicted = priors._prior(query, replace(PLACE, predicted_by=20), keyframes[3])
    np.testing.assert_array_equal(predicted.T_local_query, PLACE.T_local_query)


@pytest.mark.parametrize("since", [3, 60])
def test_a_prior_is_as_wide_as_the_odometry_may_have_drifted_since(
    keyframes: list[Keyframe], query: Query, since: int
) -> None:
    priors = make_priors(keyframes)
    sigma_m, sigma_rad = priors.track.drift_sigmas(since, COUNT - 1)
    landmark_sigma_m = CONFIG.calibration.objects.landmark_sigma_m
    for prior in (
        priors._prior(query, PLACE, keyframes[since]),
        priors._prior(query, replace(PLACE, predicted_by=since), keyframes[0]),
    ):
        assert prior.sigma_m == pytest.approx(np.hypot(SLIP_INFLATION * sigma_m, landmark_sigma_m))
        assert prior.sigma_rad == pytest.approx(np.hypot(SLIP_INFLATION * sigma_rad, CLOSURE_SIGMA_RAD))
        travel_m = LATEST_M - STEP_M * since
        assert prior.failure_probability == failure_probability(CONFIG.localization.failures_per_km, travel_m)
