"""What other programs get: read back by their own readers, or by ours where there is none."""

from __future__ import annotations

import csv
import json
import shutil
import subprocess
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from rosbags.highlevel import AnyReader

from logs.messages import ObjectDetections, Odometry
from logs.reader import LogReader
from logs.storage.ros2_definitions import typestore
from logs.writer import LogWriter
from slam.common.georeference import Georeference
from slam.evaluation.evaluate import evaluate
from slam.evaluation.inputs.records import EvaluationRecords, read_records
from slam.object_map.map_io import confirmed
from tests.tools.runs import Run, assert_refused

ORIGIN = "60.1699,24.9384,12.5,30"


@pytest.fixture(scope="module")
def records(mapped: Path) -> EvaluationRecords:
    return read_records(mapped)


def test_a_map_far_up_is_exported(dslam: Run, tmp_path: Path) -> None:
    """The variances of places are beyond the squares of their coordinates where directions are hardly known."""
    places = np.random.default_rng(0).uniform(-40.0, 40.0, (20, 3))
    with LogWriter(tmp_path / "drive.mcap") as writer:
        for i in range(40):
            T_odom_body = np.eye(4)
            T_odom_body[:3, 3] = i, 0.0, 1e7 * i
            writer.write("/odom", Odometry(i * 10**9, T_odom_body))
            writer.write("/objects", ObjectDetections(i * 10**9, "base_link", places, ("tree",) * 20, np.ones(20)))
    assert dslam("replay", tmp_path / "drive.mcap", "-o", tmp_path / "mapped.mcap").code == 0
    result = dslam("export", tmp_path / "mapped.mcap", "--g2o", tmp_path / "graph.g2o")
    assert (result.code, result.err) == (0, "")


class TestLandmarks:
    def test_a_table(self, dslam: Run, mapped: Path, records: EvaluationRecords, tmp_path: Path) -> None:
        assert dslam("export", mapped, "--csv", tmp_path / "l.csv").code == 0
        rows = list(csv.DictReader((tmp_path / "l.csv").read_text().splitlines()))
        objects = confirmed(records.object_map)
        assert [row["id"] for row in rows] == list(objects.ids)
        assert [row["label"] for row in rows] == list(objects.labels)
        positions = np.array([[float(row[f"{axis}_m"]) for axis in "xyz"] for row in rows])
        np.testing.assert_array_equal(positions, objects.positions)

    def test_geopandas_reads_exported_places(
        self, dslam: Run, mapped: Path, records: EvaluationRecords, tmp_path: Path
    ) -> None:
        geopandas = pytest.importorskip("geopandas", reason="geopandas is not installed")
        assert dslam("export", mapped, "--geojson", tmp_path / "l.geojson", "--origin", ORIGIN).code == 0
        layer = geopandas.read_file(tmp_path / "l.geojson")
        objects = confirmed(records.object_map)
        assert layer.crs.to_epsg(min_confidence=20) in (4326, 4979)
        assert layer["label"].tolist() == list(objects.labels)
        expected = Georeference(60.1699, 24.9384, 12.5, np.deg2rad(30.0)).to_geodetic(objects.positions)
        found = np.column_stack([layer.geometry.y, layer.geometry.x])
        np.testing.assert_allclose(found, expected[:, :2], rtol=0, atol=1e-6)

    def test_poses_on_earth(self, dslam: Run, mapped: Path, records: EvaluationRecords, tmp_path: Path) -> None:
        assert dslam("export", mapped, "--geodetic", tmp_path / "p.csv", "--origin", ORIGIN).code == 0
        rows = list(csv.DictReader((tmp_path / "p.csv").read_text().splitlines()))
        found = [[float(row[name]) for name in ("latitude_deg", "longitude_deg", "altitude_m")] for row in rows]
        positions = records.trajectory.T_map_body[:, :3, 3]
        there = Georeference(60.1699, 24.9384, 12.5, np.deg2rad(30.0)).to_map(np.array(found))
        np.testing.assert_allclose(there, positions, atol=2e-3)
        assert_refused(dslam("export", mapped, "--geodetic", tmp_path / "q.csv"), "--origin")

    def test_places_on_earth_need_an_origin(self, dslam: Run, mapped: Path, tmp_path: Path) -> None:
        assert_refused(dslam("export", mapped, "--geojson", tmp_path / "l.json"), "--origin")
        assert_refused(dslam("export", mapped, "--geojson", tmp_path / "l.json", "--origin", "north"), "LAT,LON")


class TestBag:
    def test_ros_reads_the_same_poses_and_landmarks(
        self, dslam: Run, mapped: Path, records: EvaluationRecords, tmp_path: Path
    ) -> None:
        assert dslam("export", mapped, "--ros2-bag", tmp_path / "bag").code == 0
        found: dict[str, list[tuple[int, Any]]] = {}
        with AnyReader([tmp_path / "bag"], default_typestore=typestore()) as reader:
            for connection, stamp_ns, data in reader.messages():
                message = reader.deserialize(data, connection.msgtype)
                found.setdefault(connection.topic, []).append((stamp_ns, message))
        expected = records.trajectory
        assert [stamp_ns for stamp_ns, _ in found["/slam/odometry"]] == expected.stamps_ns.tolist()
        (_, path), *_ = found["/slam/path"]
        for poses in (
            [m.pose.pose.position for _, m in found["/slam/odometry"]],
            [m.transforms[0].transform.translation for _, m in found["/tf"]],
            [p.pose.position for p in path.poses],
        ):
            np.testing.assert_array_equal([[p.x, p.y, p.z] for p in poses], expected.T_map_body[:, :3, 3])
        objects = confirmed(records.object_map)
        _, detections = found["/slam/map"][0]
        assert [d.results[0].hypothesis.class_id for d in detections.detections] == list(objects.labels)
        assert [d.id for d in detections.detections] == list(objects.ids)
        centres = [d.results[0].pose.pose.position for d in detections.detections]
        np.testing.assert_array_equal([[p.x, p.y, p.z] for p in centres], objects.positions)

    def test_a_bag_that_is_there_is_kept(self, dslam: Run, mapped: Path, tmp_path: Path) -> None:
        (tmp_path / "bag").mkdir()
        assert_refused(dslam("export", mapped, "--ros2-bag", tmp_path / "bag"), "exists already")
        assert_refused(dslam("export", mapped, "--ros2-bag", "."), "exists already")


class TestTracks:
    @pytest.mark.parametrize("of", ["estimate", "online", "odometry", "truth"])
    def test_each_track_has_its_poses(
        self, dslam: Run, mapped: Path, records: EvaluationRecords, tmp_path: Path, of: str
    ) -> None:
        assert dslam("export", mapped, "--of", of, "--tum", tmp_path / "t.txt").code == 0
        positions = np.loadtxt(tmp_path / "t.txt")[:, 1:4]
        expected = {
            "estimate": lambda: records.trajectory.T_map_body,
            "online": lambda: np.array([pose.T_map_body for pose in records.online_poses]),
            "odometry": lambda: np.array([pose.T_odom_body for pose in records.odometry]),
            "truth": lambda: np.array([pose.T_world_body for pose in records.true_poses]),
        }[of]()
        np.testing.assert_array_equal(positions, expected[:, :3, 3])

    @pytest.mark.slow
    @pytest.mark.skipif(shutil.which("evo_ape") is None, reason="evo is not installed")
    def test_evo_finds_the_same_error(
        self, dslam: Run, mapped: Path, records: EvaluationRecords, tmp_path: Path
    ) -> None:
        for of in ("estimate", "truth"):
            assert dslam("export", mapped, "--of", of, "--tum", tmp_path / f"{of}.txt").code == 0
        command = ["evo_ape", "tum", "truth.txt", "estimate.txt", "--align", "--silent", "--save_results", "ape.zip"]
        environment = {"HOME": str(tmp_path), "PATH": str(Path(shutil.which("evo_ape")).parent)}
        subprocess.run(command, cwd=tmp_path, check=True, capture_output=True, env=environment)
        shutil.unpack_archive(tmp_path / "ape.zip", tmp_path / "ape")
        found = json.loads((tmp_path / "ape" / "stats.json").read_text())["rmse"]
        assert found == pytest.approx(evaluate(records).estimate.ate_m, abs=1e-6)


class TestFoxglove:
    def test_the_layout_shows_topics_that_a_map_has(self, dslam: Run, mapped: Path, tmp_path: Path) -> None:
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
