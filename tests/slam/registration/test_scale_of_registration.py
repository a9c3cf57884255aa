"""Constellations of any size are registered alike."""

from __future__ import annotations

import numpy as np
import pytest

from slam.common.arrays import FloatArray, IntArray
from slam.common.geometry import apply, invert, transform_from_xyz_yaw
from slam.registration.parameters import RegistrationConfig
from slam.registration.registration import Registration, refine, register
from tests.helpers.scaled_settings import scaled_config

T_GT = transform_from_xyz_yaw(np.array([150.0, 170.0, 1.0]), 0.7)
SIGMA_M = 0.1
SCALES = (1e-3, 0.05, 20.0, 1e3)


def config(scale: float) -> RegistrationConfig:
    return RegistrationConfig.model_validate(scaled_config(RegistrationConfig(), scale))


def objects() -> tuple[FloatArray, IntArray, FloatArray, IntArray]:
    """Those of a map, and a noisy view of the ones around a pose."""
    rng = np.random.default_rng(3)
    positions = np.column_stack([rng.uniform(0.0, 300.0, (300, 2)), rng.normal(0.0, 0.5, 300)])
    labels = rng.integers(0, 4, 300)
    near = np.flatnonzero(np.hypot(*(positions[:, :2] - T_GT[:2, 3]).T) < 30.0)
    seen = apply(invert(T_GT), positions[near]) + rng.normal(0.0, SIGMA_M, (len(near), 3))
    return positions, labels, seen, labels[near]


def refined(scale: float) -> Registration:
    positions, labels, seen, seen_labels = objects()
    T_initial = T_GT @ transform_from_xyz_yaw(np.array([1.0, -1.0, 0.0]), 0.03)
    T_initial[:3, 3] *= scale
    return refine(
        scale * seen,
        seen_labels,
        scale * positions,
        labels,
        T_initial,
        config(scale),
        query_sigmas=np.full(len(seen), scale * SIGMA_M),
        reference_sigmas=np.full(len(positions), scale * SIGMA_M),
    )


def registered(scale: float) -> Registration:
    positions, labels, seen, seen_labels = objects()
    return register(
        scale * seen,
        scale * positions,
        np.argwhere(seen_labels[:, None] == labels),
        config(scale),
        query_sigmas=np.full(len(seen), scale * SIGMA_M),
        reference_sigmas=np.full(len(positions), scale * SIGMA_M),
    )[0]


@pytest.mark.parametrize("scale", SCALES)
@pytest.mark.parametrize("method", [refined, registered])
def test_a_scaled_constellation_has_the_scaled_pose(method, scale):
    expected, answer = method(1.0), method(scale)
    assert expected.found, expected.reason
    assert np.linalg.norm((expected.T_reference_query - T_GT)[:2, 3]) < 0.2
    assert answer.pairs.tolist() == expected.pairs.tolist()
    assert answer.score == pytest.approx(expected.score, abs=1e-6)
    np.testing.assert_allclose(
        answer.T_reference_query[:3, 3] / scale, expected.T_reference_query[:3, 3], rtol=0.0, atol=1e-6
    )
