"""Drives that are mapped live and as replays."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from logs.messages import Transform
from slam.common.config import Config
from slam.simulation.config import SimulationConfig
from slam.sweeps.mapped_drive import MappedDrive
from tests.helpers.short_drives import drive, keep_until, raw_messages, write_log
from tests.tools.runs import Run, assert_refused
from tools.lab.drives.live_drives import compare_with_replays, map_live, write_half


def mapped(ate_m: float) -> MappedDrive:
    return MappedDrive("", evaluation={"trajectory": {"ate_m": ate_m}})


def test_halves_hold_all_messages_and_transforms_twice(tmp_path: Path) -> None:
    entries = keep_until(drive(SimulationConfig()), 4.0)
    start_ns = entries[0][1]
    sensor = ("/tf_static", start_ns, Transform(start_ns, "base_link", "lidar", np.eye(4)))
    log, halves = write_log(tmp_path / "drive.mcap", [sensor, *entries]), []
    for is_second in (False, True):
        write_half(log, tmp_path / "half.mcap", is_second=is_second)
        halves.append(raw_messages(tmp_path / "half.mcap"))
    whole = raw_messages(log)
    assert len(halves[0]) + len(halves[1]) == len(whole) + 1
    assert [raw.topic for raw in halves[1]].count("/tf_static") == 1
    later = [raw.log_time_ns for raw in halves[1] if raw.topic != "/tf_static"]
    assert max(raw.log_time_ns for raw in halves[0]) < min(later)


def test_ratios_are_those_of_live_by_replayed() -> None:
    runs = [mapped(0.1), mapped(0.11), mapped(0.2), MappedDrive("", error="no odometry")]
    assert compare_with_replays(runs, "trajectory.ate_m") == [None, pytest.approx(1.1), None, None]


@pytest.mark.slow
def test_drive_is_mapped_in_four_ways(tmp_path: Path) -> None:
    entries = keep_until(drive(SimulationConfig()), 12.0)
    runs = map_live(lambda log, _: write_log(log, entries), tmp_path, Config(), tmp_path)
    assert [run.error for run in runs] == [""] * 4
    for key in ("trajectory.ate_m", "trajectory.online_ate_m"):
        assert [ratio is None for ratio in compare_with_replays(runs, key)] == [True, False, True, False]


def test_unknown_drive_is_refused(dslam: Run, tmp_path: Path) -> None:
    assert_refused(dslam("benchmark", "live", tmp_path, "--drive", "nowhere"), "no 'nowhere'", "kitti00")
