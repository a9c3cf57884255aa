from __future__ import annotations

import numpy as np
import pytest

from slam.simulation.config import DriveConfig, TrafficConfig
from slam.simulation.drive import plan_drive
from slam.simulation.traffic import drive_traffic

AT_S = np.arange(0.0, 100.0, 0.5)


@pytest.mark.parametrize("heading_rad", [0.0, 1.0, np.pi / 2])
def test_vehicles_keep_right_and_to_their_own_steady_speed_and_turn_round_at_the_ends(heading_rad: float) -> None:
    ahead = np.array([np.cos(heading_rad), np.sin(heading_rad)])
    right = np.array([ahead[1], -ahead[0]])
    plan = plan_drive(np.stack([np.zeros(2), 300.0 * ahead]), DriveConfig())
    config = TrafficConfig(vehicles=20, min_speed_mps=4.0, max_speed_mps=9.0, lane_offset_m=2.5)
    traffic = drive_traffic(plan, AT_S, config, rng=np.random.default_rng(0))
    x, y = traffic[..., :2] @ right, traffic[..., :2] @ ahead
    assert y.min() >= -1e-9
    assert y.max() <= 300.0 + 1e-9
    velocity = np.diff(y, axis=0) / 0.5
    steady = np.sign(x[1:]) == np.sign(x[:-1])  # not turning round in that interval
    # Driving back, its right is the other side of the tour.
    np.testing.assert_allclose(x, 2.5 * np.sign(x), atol=1e-9)
    np.testing.assert_array_equal(np.sign(velocity)[steady], np.sign(x[1:])[steady])
    for k in range(20):
        speeds = np.abs(velocity[:, k][steady[:, k]])
        assert 4.0 <= speeds[0] <= 9.0
        np.testing.assert_allclose(speeds, speeds[0], atol=1e-9)
    assert not steady.all()
    assert len(set(velocity[0].tolist())) == 20
