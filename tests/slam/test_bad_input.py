"""Drives with faulty input: refused with an error of ours, or mapped, and the final status counts what was lost."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from logs.messages import ObjectDetections, Odometry
from slam.common.config import Config, load_config
from slam.common.errors import InputDataError
from slam.common.geometry import apply, transform_from_xyz_yaw
from slam.replay import replay
from tests.helpers.landmarks import spheres
from tests.helpers.short_drives import Entry, change, final_status, keep_until, records_of, write_log

pytestmark = pytest.mark.slow


@pytest.fixture(scope="module")
def entries(noisy_drive: list[Entry]) -> list[Entry]:
    """Eight seconds, 80 odometry messages and 80 scans."""
    return keep_until(noisy_drive, 8.0)


@pytest.fixture
def output(tmp_path: Path) -> Path:
    return tmp_path / "out.mcap"


def mapped(entries: list[Entry], output: Path) -> dict[str, int]:
    """Counters of the final status, after a replay that must succeed and leave sound numbers."""
    replay(write_log(output.with_name("in.mcap"), entries), output, Config())
    (trajectory,) = records_of(output, "/slam/trajectory_stamped")
    (object_map,) = records_of(output, "/slam/map")
    assert np.isfinite(trajectory.T_map_body).all()
    assert np.isfinite(object_map.positions).all()
    return final_status(output).counters


# Poses


def test_huge_coordinates_give_the_same_map_elsewhere(entries, output):
    T = transform_from_xyz_yaw(np.array([1e7, -1e7, 100.0]), 1.2)
    here = mapped(entries, output)
    (map_here,) = records_of(output, "/slam/map")
    moved = change(entries, Odometry, lambda i, record: replace(record, T_odom_body=T @ record.T_odom_body))
    there = mapped(moved, output)
    (map_there,) = records_of(output, "/slam/map")
    assert here["landmarks_confirmed"] == there["landmarks_confirmed"]
    assert map_here.ids == map_there.ids
    np.testing.assert_allclose(map_there.positions, apply(T, map_here.positions), atol=0.01)


# Detections


@pytest.mark.parametrize("sigma_m", [1e-9, 1e9])
def test_covariances_that_are_absurd_do_not_break_the_solver(entries, output, sigma_m):
    def claim(i: int, detections: ObjectDetections) -> ObjectDetections:
        return replace(detections, covariances=spheres(sigma_m, len(detections.labels)))

    assert mapped(change(entries, ObjectDetections, claim), output)["detections_used"] == 80


def test_noises_that_differ_beyond_float64_are_refused(entries, output):
    config = load_config(None, ["calibration.odometry.translation_sigma=1.7e9"])
    source = write_log(output.with_name("in.mcap"), entries)
    with pytest.raises(InputDataError, match="orders of magnitude"):
        replay(source, output, config)
    assert not output.exists()
