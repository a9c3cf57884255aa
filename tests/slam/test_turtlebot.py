"""A real turtlebot in a hall: its odometry, furniture that is made up, and the truth of its particle filter."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from scipy.spatial import cKDTree

from logs.messages import GroundTruthPose, ObjectDetections, Odometry, Transform
from logs.reader import LogReader
from logs.selection import select_all
from logs.writer import LogWriter
from slam.common.arrays import FloatArray, IntArray
from slam.common.geometry import apply, interpolate, invert
from slam.evaluation.evaluate import evaluate
from slam.evaluation.inputs.records import read_records
from slam.replay import replay
from tests.helpers.data import NAV2, needs_nav2

pytestmark = [pytest.mark.slow, needs_nav2]

CLASSES = ("chair", "table", "shelf", "door", "plant")
RANGE_M = 5.0
SIGMA_M = 0.03
PERIOD_NS = 200_000_000


def recorded() -> tuple[list[Odometry], IntArray, FloatArray]:
    """The odometry, and the poses (K, 4, 4) of the body in the map by /tf at stamps (K,)."""
    odometry, corrections = list[Odometry](), list[Transform]()
    with LogReader(NAV2) as reader:
        for entry in reader.records(select_all(reader.topics())):
            if isinstance(entry.record, Odometry) and entry.topic == "/odom":
                odometry.append(entry.record)
            elif isinstance(entry.record, Transform) and entry.record.parent_frame_id == "map":
                corrections.append(entry.record)
    stamps = np.array([each.stamp_ns for each in odometry], dtype=np.int64)
    at = np.array([each.stamp_ns for each in corrections], dtype=np.int64)
    # The filter corrects in steps; between two of them the truth goes on smoothly.
    inside = (stamps >= at[0]) & (stamps <= at[-1])
    T_map_odom = interpolate(at, np.stack([each.T_parent_child for each in corrections]), stamps[inside])
    T_odom_body = np.stack([each.T_odom_body for each in odometry])[inside]
    return odometry, stamps[inside], T_map_odom @ T_odom_body


def write(path: Path, *, seed: int) -> None:
    """A log of the odometry with furniture beside the way, an object every metre or so."""
    rng = np.random.default_rng(seed)
    odometry, stamps, T_map_body = recorded()
    way = T_map_body[::20, :3, 3]
    places = way[rng.integers(len(way), size=200)] + np.column_stack([rng.uniform(-3.5, 3.5, (200, 2)), np.zeros(200)])
    places = places[cKDTree(way).query(places)[0] > 0.6][:40]
    names = rng.choice(CLASSES, len(places))
    with LogWriter(path) as writer:
        for each in odometry:
            writer.write("/odom", each, each.stamp_ns)
        for stamp_ns, T in zip(stamps.tolist(), T_map_body, strict=True):
            writer.write("/ground_truth", GroundTruthPose(stamp_ns, T), stamp_ns)
        times = np.arange(stamps[0], stamps[-1], PERIOD_NS)
        for stamp_ns, T in zip(times.tolist(), interpolate(stamps, T_map_body, times), strict=True):
            seen = apply(invert(T), places)
            kept = (np.hypot(seen[:, 0], seen[:, 1]) < RANGE_M) & (rng.random(len(seen)) < 0.9)
            noisy = seen[kept] + rng.normal(0.0, SIGMA_M, (int(kept.sum()), 3))
            scan = ObjectDetections(stamp_ns, "base_link", noisy, tuple(names[kept].tolist()), np.ones(len(noisy)))
            writer.write("/detections", scan, stamp_ns)


@pytest.mark.parametrize("seed", [0, 1])
def test_furniture_takes_the_drift_from_the_odometry(tmp_path: Path, seed: int) -> None:
    write(tmp_path / "hall.mcap", seed=seed)
    replay(tmp_path / "hall.mcap", tmp_path / "map.mcap")
    result = evaluate(read_records(tmp_path / "map.mcap"))
    told = result.to_json_dict()["trajectory"]
    assert told["odometry_ate_m"] > 0.3
    assert told["ate_m"] < 0.1
