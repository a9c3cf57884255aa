from itertools import pairwise

import numpy as np
import pytest
from scipy.spatial import cKDTree

from slam.common.errors import SimulationError
from slam.common.geometry import yaw_rad
from slam.simulation.config import DriveConfig
from slam.simulation.drive import START_NS, Drive, plan_drive

CORNER = np.array([[0.0, 0.0], [60.0, 0.0], [60.0, 60.0]])
CONFIG = DriveConfig()
THERE_AND_BACK = np.array([[0.0, 0.0], [60.0, 0.0], [0.0, 0.0]])


def _drive(tour: np.ndarray, config: DriveConfig = CONFIG) -> Drive:
    plan = plan_drive(tour, config)
    return plan.sample(0.0, plan.length_m)


def _rates(drive: Drive) -> tuple[np.ndarray, np.ndarray]:
    """Speeds (m/s) and yaw rates (rad/s) between poses."""
    speed = np.linalg.norm(np.diff(drive.T_world_body[:, :3, 3], axis=0), axis=1) * CONFIG.rate_hz
    turn = np.diff(np.unwrap(yaw_rad(drive.T_world_body))) * CONFIG.rate_hz
    return speed, turn


def test_straight_tour_is_driven_at_cruising_speed_from_end_to_end() -> None:
    drive = _drive(np.array([[1.0, 2.0], [1.0, 82.0]]), DriveConfig(speed_mps=8.0))
    assert drive.stamps_ns.tolist() == [START_NS + 100_000_000 * number for number in range(101)]
    np.testing.assert_allclose(drive.T_world_body[[0, -1], :3, 3], [[1, 2, 0], [1, 82, 0]], atol=1e-6)
    np.testing.assert_allclose(yaw_rad(drive.T_world_body), np.pi / 2, atol=1e-9)
    np.testing.assert_allclose(_rates(drive)[0], 8.0, rtol=1e-6)


def test_corner_is_rounded_slowly_and_near_the_tour() -> None:
    drive = _drive(CORNER)
    speed, turn = _rates(drive)
    assert np.abs(turn).max() <= CONFIG.max_yaw_rate_radps * 1.001
    assert speed.max() <= CONFIG.speed_mps * 1.001
    assert speed.min() < 2.0
    dense = np.concatenate([np.linspace(a, b, 600) for a, b in pairwise(CORNER)])
    distance_m, _ = cKDTree(dense).query(drive.T_world_body[:, :2, 3])
    assert distance_m.max() < 1.0
    np.testing.assert_allclose(yaw_rad(drive.T_world_body)[[0, -1]], [0.0, np.pi / 2], atol=1e-6)


def test_bends_are_slowed_down_to_the_lateral_acceleration() -> None:
    angle = np.linspace(0.0, 3.0, 200)
    bend = 12.0 * np.stack([np.sin(angle), 1.0 - np.cos(angle)], axis=1)
    tour = np.concatenate([[[-60.0, 0.0]], bend])
    config = DriveConfig(max_lateral_acceleration_mps2=1.0)
    speed, turn = _rates(_drive(tour, config))
    assert (speed * np.abs(turn)).max() < 1.05
    assert speed[:40].max() == pytest.approx(8.0)
    assert np.median(speed[-40:]) == pytest.approx(np.sqrt(12.0), rel=0.02)


def test_turning_back_happens_on_the_spot_at_the_yaw_rate() -> None:
    drive = _drive(THERE_AND_BACK)
    assert np.isfinite(drive.T_world_body).all()
    _, turn = _rates(drive)
    assert np.abs(turn).max() <= CONFIG.max_yaw_rate_radps * 1.001
    assert abs(np.cos(yaw_rad(drive.T_world_body)[-1]) + 1.0) < 1e-6
    np.testing.assert_allclose(drive.T_world_body[-1, :3, 3], [0, 0, 0], atol=1.0)


def test_piece_of_the_tour_starts_and_ends_where_asked() -> None:
    plan = plan_drive(CORNER, CONFIG)
    drive = plan.sample(30.0, 90.0, start_ns=5)
    assert drive.stamps_ns[0] == 5
    np.testing.assert_allclose(drive.T_world_body[0, :3, 3], [30, 0, 0], atol=1e-6)
    assert drive.T_world_body[-1, 0, 3] == pytest.approx(60.0, abs=0.1)
    assert 28.0 < drive.T_world_body[-1, 1, 3] < 31.0


@pytest.mark.parametrize(("from_m", "to_m"), [(-1.0, 50.0), (50.0, 50.0), (0.0, 121.0)])
def test_piece_outside_the_tour_is_refused(from_m: float, to_m: float) -> None:
    with pytest.raises(SimulationError, match=r"from 0 to 120\.0 m"):
        plan_drive(CORNER, CONFIG).sample(from_m, to_m)


def test_repeated_points_do_no_harm() -> None:
    repeated = np.repeat(CORNER, 3, axis=0)
    np.testing.assert_array_equal(_drive(repeated).T_world_body, _drive(CORNER).T_world_body)
