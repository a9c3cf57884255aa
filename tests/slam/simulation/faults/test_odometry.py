"""Faults of the odometry: where they are, how large they are, and that nothing else differs."""

from __future__ import annotations

import numpy as np
import pytest

from logs.messages import Odometry
from slam.common.arrays import FloatArray
from slam.common.errors import SimulationError
from slam.common.geometry import invert, rotation_angle_rad, travelled_m, yaw_rad
from slam.simulation.faults.faulty_log import apply_faults
from slam.simulation.faults.registry import parse_faults
from tests.slam.simulation.faults.streams import (
    COUNT,
    HALF_NS,
    PERIOD_NS,
    STAMPS_NS,
    drive,
    faulty,
    path,
    poses,
    records,
    stamps,
    steps,
)

HALF = 50


def step_errors(*names: str) -> FloatArray:
    """What each step has more than that of the drive as it is: (COUNT - 1, 4, 4)."""
    return np.asarray(invert(steps(drive())) @ steps(faulty(*names)))


def changed_steps(*names: str) -> list[int]:
    return np.flatnonzero(np.abs(step_errors(*names) - np.eye(4)).max(axis=(1, 2)) > 1e-9).tolist()


def test_the_heading_jumps_once_by_the_angle() -> None:
    assert changed_steps("heading_jump=30:0.25") == [24]
    assert yaw_rad(step_errors("heading_jump=30:0.25")[24]) == pytest.approx(np.deg2rad(30.0))
    assert np.array_equal(poses(faulty("heading_jump=30"))[:HALF], poses(drive())[:HALF])


def test_the_pitch_jumps_once_by_the_angle() -> None:
    assert changed_steps("pitch_jump=20") == [HALF - 1]
    assert rotation_angle_rad(step_errors("pitch_jump=20")[HALF - 1]) == pytest.approx(np.deg2rad(20.0))
    assert yaw_rad(step_errors("pitch_jump=20")[HALF - 1]) == pytest.approx(0.0)


def test_as_many_jumps_of_the_distance() -> None:
    assert len(changed_steps("odometry_jumps=4:1.5")) == 4
    errors = step_errors("odometry_jumps=4:1.5")[changed_steps("odometry_jumps=4:1.5")]
    assert np.linalg.norm(errors[:, :2, 3], axis=1) == pytest.approx(np.full(4, 1.5))
    assert not errors[:, 2, 3].any()


def test_one_wild_message() -> None:
    changed, before = poses(faulty("odometry_wild=1000")), poses(drive())
    moved = np.linalg.norm(changed[:, :3, 3] - before[:, :3, 3], axis=1)
    assert np.flatnonzero(moved).tolist() == [HALF]
    assert moved[HALF] == pytest.approx(1000.0)


def test_frozen_from_a_part_on() -> None:
    changed, before = poses(faulty("odometry_frozen=0.25")), poses(drive())
    assert np.array_equal(changed[:26], before[:26])
    assert np.array_equal(changed[25:], np.tile(before[25], (COUNT - 25, 1, 1)))


def test_frozen_for_a_while() -> None:
    errors = faulty("odometry_freezes=2")
    assert changed_steps("odometry_freezes=2") == list(range(HALF, HALF + 20))
    assert travelled_m(poses(errors))[-1] == pytest.approx(travelled_m(poses(drive()))[-1] - 20 * 0.51)


def test_no_odometry_for_a_while() -> None:
    left = stamps(faulty("odometry_pause=2"), Odometry)
    assert set(STAMPS_NS.tolist()) - set(left.tolist()) == set(STAMPS_NS[HALF : HALF + 20].tolist())


def test_stamps_run_backwards_for_a_while() -> None:
    fall = np.flatnonzero(np.diff(stamps(faulty("odometry_backwards=2"), Odometry)) < 0)
    assert fall.tolist() == list(range(HALF, HALF + 19))
    assert stamps(faulty("odometry_backwards=2"), Odometry)[HALF] == HALF_NS + 20 * PERIOD_NS


def test_travel_is_scaled_and_headings_are_not() -> None:
    changed, before = poses(faulty("odometry_scale=1.2")), poses(drive())
    assert travelled_m(changed)[-1] == pytest.approx(1.2 * travelled_m(before)[-1])
    assert np.array_equal(changed[:, :3, :3], before[:, :3, :3])


def test_the_heading_turns_the_other_way() -> None:
    assert yaw_rad(steps(faulty("odometry_yaw_inverted"))) == pytest.approx(-yaw_rad(steps(drive())))
    assert steps(faulty("odometry_yaw_inverted"))[:, :3, 3] == pytest.approx(steps(drive())[:, :3, 3])


def test_turns_are_multiplied() -> None:
    assert yaw_rad(steps(faulty("odometry_turns=1.1"))) == pytest.approx(1.1 * yaw_rad(steps(drive())))
    assert steps(faulty("odometry_turns=1.1"))[:, :3, 3] == pytest.approx(steps(drive())[:, :3, 3])


def test_the_gyroscope_is_biased_for_a_while() -> None:
    errors = yaw_rad(step_errors("gyro_bias=3:2"))
    assert changed_steps("gyro_bias=3:2") == list(range(HALF, HALF + 20))
    assert errors.sum() == pytest.approx(np.deg2rad(6.0))


@pytest.mark.parametrize("fault", ["odometry_translation_noise", "odometry_yaw_noise"])
def test_odometry_noise_grows_with_the_root_of_the_travel(fault: str) -> None:
    root_m = np.sqrt(np.linalg.norm(steps(drive())[:, :3, 3], axis=1))
    found = []
    for seed in range(10):
        errors = invert(steps(drive())) @ steps(faulty(f"{fault}=0.02", seed=seed))
        size = yaw_rad(errors) if fault == "odometry_yaw_noise" else errors[:, 1, 3]
        found.append(size / root_m)
    assert np.std(found) == pytest.approx(0.02, rel=4.0 / np.sqrt(2.0 * 10 * (COUNT - 1)))
    assert np.array_equal(poses(faulty(f"{fault}=0.02"))[0], poses(drive())[0])


def test_z_down_turns_the_other_way_and_up_is_down() -> None:
    changed = steps(faulty("odometry_z_down"))
    assert yaw_rad(changed) == pytest.approx(-yaw_rad(steps(drive())))
    assert changed[:, 0, 3] == pytest.approx(steps(drive())[:, 0, 3])
    assert changed[:, 1:3, 3] == pytest.approx(-steps(drive())[:, 1:3, 3])


def test_a_second_odometry_between_the_messages() -> None:
    changed, before = faulty("odometry_interleaved=1"), poses(drive())
    assert [e.log_time_ns for e in changed] == sorted(e.log_time_ns for e in changed)
    assert len(records(changed, Odometry)) == 2 * COUNT - 1
    assert np.array_equal(poses(changed)[::2], before)
    assert np.all(np.diff(stamps(changed, Odometry)) == PERIOD_NS // 2)
    middles = 0.5 * (before[:-1, :3, 3] + before[1:, :3, 3]) + [0.0, 1.0, 0.0]
    assert poses(changed)[1::2, :3, 3] == pytest.approx(middles)


@pytest.mark.parametrize("factor", [0.0, 0.3, 1.0, 3.0])
def test_errors_against_the_truth_are_multiplied(factor: float) -> None:
    truth = path()
    true_steps = invert(truth[:-1]) @ truth[1:]
    errors = invert(true_steps) @ steps(faulty(f"odometry_noise={factor}"))
    before = invert(true_steps) @ steps(drive())
    assert yaw_rad(errors) == pytest.approx(factor * yaw_rad(before), abs=1e-9)
    assert errors[:, :3, 3] == pytest.approx(factor * before[:, :3, 3], abs=1e-9)


def test_errors_cannot_be_multiplied_without_the_truth() -> None:
    without = [entry for entry in drive() if entry.topic != "/ground_truth"]
    with pytest.raises(SimulationError, match="odometry_noise=3: the log holds no true poses"):
        apply_faults(without, parse_faults(["odometry_noise"]), seed=0)


def test_wheels_slip_for_a_while() -> None:
    assert changed_steps("wheel_slip=1.5:2") == list(range(HALF, HALF + 20))
    before, after = steps(drive()), steps(faulty("wheel_slip=1.5:2"))
    assert after[HALF, :3, 3] == pytest.approx(1.5 * before[HALF, :3, 3])
    assert after[:, :3, :3] == pytest.approx(before[:, :3, :3])


def test_the_odometry_begins_again_at_the_origin() -> None:
    changed = poses(faulty("odometry_restart"))
    assert changed[HALF] == pytest.approx(np.eye(4))
    assert changed_steps("odometry_restart") == [HALF - 1]
    assert np.array_equal(changed[:HALF], poses(drive())[:HALF])
