"""What other programs get: read back by their own readers, or by ours where there is none."""

import json
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from logs.importers.maps.geojson import read_geojson
from logs.messages import Odometry
from logs.reader import LogReader
from logs.writer import LogWriter
from slam.common.georeference import Georeference
from slam.evaluation.inputs.records import EvaluationRecords, read_records
from slam.object_map.map_io import confirmed
from tests.helpers.landmarks import detections_of
from tests.helpers.poses import pose_at
from tests.tools.runs import Run, assert_refused, assert_well

ORIGIN = "60.1699,24.9384,12.5,30"


@pytest.fixture(scope="module")
def records(mapped: Path) -> EvaluationRecords:
    return read_records(mapped)


def test_a_map_far_up_is_exported(dslam: Run, tmp_path: Path) -> None:
    """The variances of places are beyond the squares of their coordinates where directions are hardly known."""
    places = np.random.default_rng(0).uniform(-40.0, 40.0, (20, 3))
    with LogWriter(tmp_path / "drive.mcap") as writer:
        for i in range(40):
            writer.write("/odom", Odometry(i * 10**9, pose_at(i, z=1e7 * i)))
            writer.write("/objects", detections_of(places, stamp_ns=i * 10**9, frame_id="base_link"))
    assert dslam("replay", tmp_path / "drive.mcap", "-o", tmp_path / "mapped.mcap").code == 0
    assert_well(dslam("export", tmp_path / "mapped.mcap", "--g2o", tmp_path / "graph.g2o"))


def test_landmarks_as_a_table(dslam: Run, mapped: Path, records: EvaluationRecords, tmp_path: Path) -> None:
    assert dslam("export", mapped, "--csv", tmp_path / "l.csv").code == 0
    table = pd.read_csv(tmp_path / "l.csv", dtype={"id": str})
    objects = confirmed(records.object_map)
    assert table["id"].tolist() == list(objects.ids)
    assert table["label"].tolist() == list(objects.labels)
    np.testing.assert_allclose(table[["x_m", "y_m", "z_m"]], objects.positions, rtol=1e-14)


def test_landmarks_and_poses_on_earth(dslam: Run, mapped: Path, records: EvaluationRecords, tmp_path: Path) -> None:
    earth = Georeference(60.1699, 24.9384, 12.5, np.deg2rad(30.0))
    places, poses = tmp_path / "l.geojson", tmp_path / "p.csv"
    assert dslam("export", mapped, "--geojson", places, "--geodetic", poses, "--origin", ORIGIN).code == 0
    objects, found = confirmed(records.object_map), read_geojson(places)
    assert found.labels == objects.labels
    assert places.read_text().count("sigma_x_m") == len(objects.labels)
    np.testing.assert_allclose(earth.to_map(found.positions)[:, :2], objects.positions[:, :2], atol=0.1)
    path = pd.read_csv(poses)[["latitude_deg", "longitude_deg", "altitude_m"]].to_numpy()
    np.testing.assert_allclose(earth.to_map(path), records.final_path.positions, atol=2e-3)
    assert_refused(dslam("export", mapped, "--geodetic", poses), "--origin")
    assert_refused(dslam("export", mapped, "--geojson", places, "--origin", "north"), "LAT,LON")


def test_each_track_has_its_poses(dslam: Run, mapped: Path, records: EvaluationRecords, tmp_path: Path) -> None:
    for of, path in (
        ("estimate", records.final_path),
        ("online", records.online_path),
        ("odometry", records.odometry_path),
        ("truth", records.true_path),
    ):
        assert dslam("export", mapped, "--of", of, "--tum", tmp_path / "t.txt").code == 0
        np.testing.assert_array_equal(np.loadtxt(tmp_path / "t.txt")[:, 1:4], path.positions, err_msg=of)


def test_the_layout_shows_topics_that_a_map_has(dslam: Run, mapped: Path, tmp_path: Path) -> None:
    layout = tmp_path / "layout.json"
    assert dslam("view", mapped, "--save", layout).code == 0
    told = json.loads(layout.read_text(encoding="utf-8"))
    panels = told["configById"]
    with LogReader(mapped) as reader:
        topics = {info.topic for info in reader.topics()}
    # A drive without a closure has no lines of closures.
    shown = {name for name in panels["3D!map"]["topics"] if "closure" not in name}
    assert {*shown, panels["RosOut!log"]["topicToRender"], panels["RawMessages!status"]["topicPath"]} <= topics
    assert panels["3D!map"]["topics"]["/slam/landmarks"]["visible"]
    assert panels["3D!map"]["scene"]["transforms"]["enablePreloading"]
