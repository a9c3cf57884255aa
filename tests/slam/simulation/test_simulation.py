import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from logs.importers.imported_log import TOPICS
from logs.reader import LogReader
from logs.selection import select_topics
from slam.common.errors import SimulationError
from slam.common.geometry import apply, invert
from slam.simulation.config import SimulationConfig
from slam.simulation.simulation import simulate, write_simulation
from slam.simulation.world import World
from tests.helpers.loop_drives import furnished


def _records(world: World, config: SimulationConfig) -> dict[str, list[Any]]:
    by_topic: dict[str, list[Any]] = {}
    for record in simulate(world, config, seed=0):
        by_topic.setdefault(TOPICS[type(record)], []).append(record)
    return by_topic


def _config(**branches: Any) -> SimulationConfig:
    return SimulationConfig.model_validate(branches)


@pytest.fixture(scope="module")
def street() -> World:
    return furnished([(0, 0), (200, 0)], seed=1)


@pytest.fixture(scope="module")
def drive(street: World) -> dict[str, list[Any]]:
    return _records(street, SimulationConfig())


def test_true_ids_match_the_detections_within_the_noise() -> None:
    street = furnished([(0, 0), (-90, 180)], seed=1)
    drive = _records(street, SimulationConfig())
    place = dict(zip(street.object_ids, street.positions, strict=True))
    normalised = []
    scans = zip(drive["/detections"], drive["/ground_truth/detections"], drive["/ground_truth"], strict=True)
    for detections, truth, pose in scans:
        for i, name in enumerate(truth.object_ids):
            if name:
                expected = apply(invert(pose.T_world_body), place[name][None])[0]
                sigma_m = 0.1 + 0.01 * np.linalg.norm(expected)
                np.testing.assert_allclose(detections.covariances[i], sigma_m**2 * np.eye(3), rtol=1e-9)
                normalised.append((detections.positions[i] - expected) / sigma_m)
    assert np.abs(normalised).max() < 5.5
    np.testing.assert_allclose(np.std(normalised, axis=0), 1.0, atol=0.05)


def test_same_seed_same_bytes_other_seed_other_bytes(tmp_path: Path, street: World) -> None:
    config = _config(kidnap={"from_m": 50, "to_m": 120}, sensor={"covariances": False})
    contents = []
    for name, seed in (("a", 1), ("b", 1), ("c", 2)):
        write_simulation(tmp_path / name, street, config, seed=seed)
        contents.append((tmp_path / name).read_bytes())
    assert contents[0] == contents[1]
    assert contents[0] != contents[2]


def test_odometry_does_not_change_with_the_sensor(street: World, drive: dict[str, list[Any]]) -> None:
    changed = _records(street, _config(sensor={"dropout": 0.0, "false_positives_per_scan": 5.0}))
    for mine, other in zip(drive["/odom"], changed["/odom"], strict=True):
        np.testing.assert_array_equal(mine.T_odom_body, other.T_odom_body)


def test_kidnapping_is_a_gap_after_which_odometry_starts_anew(street: World) -> None:
    drive = _records(street, _config(kidnap={"from_m": 60, "to_m": 150, "gap_s": 7.5}))
    stamps_ns = np.array([record.stamp_ns for record in drive["/odom"]])
    (before,) = np.flatnonzero(np.diff(stamps_ns) > 100_000_000)
    assert np.diff(stamps_ns)[before] == 7_500_000_000
    x_m = np.array([pose.T_world_body[0, 3] for pose in drive["/ground_truth"]])
    assert x_m[before] == pytest.approx(60.0, abs=0.8)
    assert x_m[before + 1] == pytest.approx(150.0, abs=0.01)
    assert x_m[-1] == pytest.approx(200.0, abs=0.8)
    assert not np.allclose(drive["/odom"][before].T_odom_body, np.eye(4))
    np.testing.assert_array_equal(drive["/odom"][before + 1].T_odom_body, np.eye(4))
    assert len(drive["/detections"]) == len(stamps_ns)


@pytest.mark.parametrize(
    ("length_m", "branches"),
    [
        (0.1, {}),
        (200.0, {"drive": {"rate_hz": 0.01}}),
        (200.0, {"kidnap": {"from_m": 0.01, "to_m": 50}}),
        (200.0, {"kidnap": {"from_m": 100, "to_m": 199.99}}),
    ],
)
def test_a_drive_too_short_to_map_is_refused(
    tmp_path: Path, street: World, length_m: float, branches: dict[str, Any]
) -> None:
    world, config = street.shortened(length_m), _config(**branches)
    with pytest.raises(SimulationError, match="too short"):
        write_simulation(tmp_path / "log.mcap", world, config, seed=0)
    assert not list(tmp_path.iterdir())


def test_log_reads_back_with_its_configuration(tmp_path: Path, street: World) -> None:
    config = _config(sensor={"max_range_m": 20})
    path = tmp_path / "drive.mcap"
    summary = write_simulation(path, street, config, seed=4)
    expected = list(simulate(street, config, seed=4))
    with LogReader(path) as reader:
        records = [entry.record for entry in reader.records(select_topics(reader.topics()))]
        metadata = reader.metadata()["simulation"]
    assert SimulationConfig.model_validate(json.loads(metadata["configuration"])) == config
    assert (metadata["world"], metadata["seed"], metadata["world_sha256"]) == ("town", "4", street.sha256())
    assert [(type(record), record.stamp_ns) for record in records] == [
        (type(record), record.stamp_ns) for record in expected
    ]
    assert sum(summary.message_counts.values()) == len(expected)
    assert summary.duration_s == pytest.approx(25.0)
