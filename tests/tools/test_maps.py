"""Saved maps by the command line: made, described, found oneself in, and refused."""

from __future__ import annotations

import hashlib
import json
import re
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from logs.reader import LogReader
from logs.scene import decode_points
from logs.writer import LogWriter
from slam.common.geometry import travelled_m
from slam.library import read_map
from slam.object_map.map_io import GRAVITY, METADATA, POINTS_TOPIC, load_map
from tests.helpers.short_drives import raw_messages, records_of
from tests.tools.runs import Run, assert_refused
from tools import cli

pytestmark = pytest.mark.slow


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Two drives along one street, one through another town, and the map of the first one."""
    folder = tmp_path_factory.mktemp("maps")
    simulate = ("simulate", "--length", "120")
    for name, more in (("first", ()), ("second", ("--set", "sensor.dropout=0.2")), ("other", ("--seed", "7"))):
        assert cli.run([*simulate, str(folder / f"{name}.mcap"), *more]) == 0
    made = ("replay", str(folder / "first.mcap"), "-o", str(folder / "out.mcap"))
    assert cli.run([*made, "--save-map", str(folder / "map.mcap")]) == 0
    return folder


@pytest.fixture
def town(folder: Path) -> Path:
    return folder / "map.mcap"


@pytest.fixture(scope="module")
def found(folder: Path) -> Path:
    output = folder / "found.mcap"
    arguments = ["relocalize", str(folder / "second.mcap"), "--map", str(folder / "map.mcap"), "-o", str(output)]
    assert cli.run([*arguments, "--picture", str(folder / "found.png")]) == 0
    return output


class TestRelocalize:
    @pytest.mark.parametrize("near", ["1,2", "1;2;3", "1,2,0", "1,2,-3", "1,2,nan", "a,b,c", "1,2,3,4,5"])
    def test_where_it_starts_is_told_in_numbers(
        self, dslam: Run, folder: Path, town: Path, tmp_path: Path, near: str
    ) -> None:
        output = tmp_path / "out.mcap"
        result = dslam("relocalize", folder / "second.mcap", "--map", town, "-o", output, f"--near={near}")
        assert_refused(result, repr(near), "X,Y,SIGMA or X,Y,YAW,SIGMA")
        assert not output.exists()

    def test_tells_when_the_robot_was_found_and_how_well_it_was_followed(
        self, dslam: Run, folder: Path, town: Path, tmp_path: Path, found: Path
    ) -> None:
        before = town.read_bytes()
        arguments = ("relocalize", folder / "second.mcap", "--map", town, "-o", tmp_path / "out.mcap")
        result = dslam(*arguments)
        assert result.code == 0
        assert result.err == ""
        seconds, metres = map(float, re.search(r"first fix +after ([\d.]+) s and ([\d.]+) m", result.out).groups())
        told = json.loads(dslam(*arguments, "--json").out)
        assert (
            round(told["time_to_first_relocalization_s"], 1),
            round(told["distance_to_first_relocalization_m"], 1),
        ) == (seconds, metres)
        assert told["found"] is True
        assert told["relocalized_keyframe_ratio"] == told["keyframes_recognised"] / told["keyframes"] > 0.5
        assert 0.5 < told["tracked_ratio"] < 1.0
        assert f"recognised     {told['keyframes_recognised']} of {told['keyframes']} keyframes" in result.out
        assert f"tracked        {100 * told['tracked_ratio']:.0f} % of the online poses" in result.out
        assert town.read_bytes() == before
        assert found.with_suffix(".png").read_bytes().startswith(b"\x89PNG")

    def test_recognised_keyframes_are_right_and_the_covariance_says_how_much(self, found: Path, folder: Path) -> None:
        """Both drives start at the same true place, so the map's frame is that of the truth at the first pose."""
        truth = {record.stamp_ns: record.T_world_body for record in records_of(found, "/ground_truth")}
        T_world_map = records_of(folder / "first.mcap", "/ground_truth")[0].T_world_body
        records = records_of(found, "/slam/relocalizations")
        assert len(records) == len({record.stamp_ns for record in records}) > 20
        assert all(record.success for record in records)
        T_errors = [
            np.linalg.inv(record.T_map_body) @ np.linalg.inv(T_world_map) @ truth[record.stamp_ns] for record in records
        ]
        errors_m = np.array([T[:2, 3] for T in T_errors])
        sigmas_m = np.sqrt([np.diag(record.covariance)[3:5] for record in records])
        assert np.linalg.norm(errors_m, axis=1).max() < 1.0
        assert np.median(np.abs(errors_m) / sigmas_m) < 2.0
        poses = records_of(found, "/slam/pose")
        assert 0 < len(poses) < len(records_of(found, "/odom"))
        assert min(pose.stamp_ns for pose in poses) >= records[0].stamp_ns

    def test_in_another_town_it_says_so(self, dslam: Run, folder: Path, town: Path, tmp_path: Path) -> None:
        picture = tmp_path / "lost.png"
        arguments = ("relocalize", folder / "other.mcap", "--map", town, "-o", tmp_path / "out.mcap")
        result = dslam(*arguments, "--picture", picture)
        assert result.code == 1
        assert "none: no place of the map was recognised" in result.out
        assert "tracked        0 %" in result.out
        assert not picture.exists()
        assert records_of(tmp_path / "out.mcap", "/slam/relocalizations") == []
        assert records_of(tmp_path / "out.mcap", "/slam/pose") == []

    def test_the_map_is_not_written_over(self, dslam: Run, folder: Path, town: Path) -> None:
        before = town.read_bytes()
        assert_refused(dslam("relocalize", folder / "second.mcap", "--map", town, "-o", town), "is the input")
        assert town.read_bytes() == before


class TestReplay:
    def test_another_descriptor_serves_the_same_map(self, dslam: Run, folder: Path, town: Path, tmp_path: Path) -> None:
        output = tmp_path / "out.mcap"
        arguments = ("relocalize", folder / "second.mcap", "--map", town, "-o", output)
        told = json.loads(dslam(*arguments, "--set", "loop_closure.descriptor=gosmatch_vertex", "--json").out)
        assert told["found"] is True
        with LogReader(output) as reader:
            configuration = json.loads(reader.metadata()["dslam"]["configuration"])
        assert configuration["loop_closure"]["descriptor"] == "gosmatch_vertex"

    def test_a_second_drive_goes_into_the_map(self, dslam: Run, folder: Path, town: Path, tmp_path: Path) -> None:
        grown = tmp_path / "grown.mcap"
        source = folder / "second.mcap"
        result = dslam("replay", source, "-o", tmp_path / "o.mcap", "--map", town, "--save-map", grown, "--json")
        assert result.code == 0
        assert json.loads(result.out)["keyframes_not_saved"] == 0
        before, after = (json.loads(dslam("info", path, "--json").out)["map"] for path in (town, grown))
        assert after["landmark_count"] <= 1.05 * before["landmark_count"]
        assert after["median_sigma_m"] <= before["median_sigma_m"]
        assert after["keyframe_count"] > before["keyframe_count"]
        assert after["path_m"] == pytest.approx(2 * before["path_m"], rel=0.1)
        hashes = [hashlib.sha256(path.read_bytes()).hexdigest() for path in (folder / "first.mcap", source)]
        assert [drive["input_sha256"] for drive in after["drives"]] == hashes

    def test_a_map_that_is_not_recognised_is_not_saved_over(
        self, dslam: Run, folder: Path, town: Path, tmp_path: Path
    ) -> None:
        target = tmp_path / "both.mcap"
        result = dslam("replay", folder / "other.mcap", "-o", tmp_path / "o.mcap", "--map", town, "--save-map", target)
        assert_refused(result, "never relocalized", "was not written")
        assert not target.exists()


class TestKinds:
    @pytest.mark.parametrize("kind", ["saved", "imported"])
    def test_every_kind_is_viewed_and_exported(self, dslam: Run, town: Path, tmp_path: Path, kind: str) -> None:
        map_log = town
        if kind == "imported":
            (tmp_path / "objects.csv").write_text("x_m,y_m,label\n0,0,tree\n5,0,pole\n0,7,tree\n6,8,tree\n")
            map_log = tmp_path / "imported.mcap"
            assert dslam("import", "map", map_log, "--file", tmp_path / "objects.csv").code == 0
        count = len(read_map(map_log).ids)
        table, places, picture = (tmp_path / f"map.{suffix}" for suffix in ("csv", "geojson", "png"))
        assert dslam("export", map_log, "--csv", table).code == 0
        assert len(table.read_text().splitlines()) == count + 1
        assert_refused(dslam("export", map_log, "--geojson", places), "--origin")
        assert dslam("export", map_log, "--geojson", places, "--origin", "60,24").code == 0
        (feature, *others) = json.loads(places.read_text())["features"]
        assert len(others) == count - 1
        assert {"label", "label_probability", "sigma_x_m", "first_seen_ns"} < feature["properties"].keys()
        assert dslam("view", map_log, "--save", picture).code == 0
        assert picture.read_bytes().startswith(b"\x89PNG")
        with LogReader(map_log) as reader:
            (points,) = reader.messages([POINTS_TOPIC])
        assert len(decode_points(points.data)) == count


class TestInfo:
    def test_no_solver_is_loaded_to_look_into_a_map(self, town: Path) -> None:
        heavy = ("gtsam", "scipy", "torch", "matplotlib", "slam.localization", "slam.common.config")
        code = (
            f"import sys; from tools.cli import run; run(['info', {str(town)!r}]); "
            f"print([m for m in {heavy!r} if m in sys.modules])"
        )
        result = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
        assert result.stdout.splitlines()[-1] == "[]"

    def test_says_what_a_map_is(self, dslam: Run, town: Path) -> None:
        result = dslam("info", town)
        assert result.code == 0
        for text in (
            "gravity z of the frame map points up",
            "this is a saved map, not a drive",
            "closure count 0",
            f"dslam relocalize LOG --map {town}",
        ):
            assert text in " ".join(result.out.split())

    def test_in_numbers(self, dslam: Run, town: Path) -> None:
        told = json.loads(dslam("info", town, "--json").out)["map"]
        saved = load_map(town)
        positions, covariances = saved.objects.positions, saved.objects.covariances
        counts = [each["landmark_count"] for each in told["classes"]]
        assert counts == sorted(counts, reverse=True)
        assert told["usable"] is True
        assert told["landmark_count"] == len(positions) == sum(counts)
        assert [told["width_m"], told["height_m"]] == np.ptp(positions[:, :2], axis=0).tolist()
        # The keyframes of a drive that never turns back lie along its path.
        assert told["path_m"] == pytest.approx(travelled_m(saved.graph.T_map_body)[-1], rel=0.02)
        sigmas_m = np.sqrt(0.5 * (covariances[:, 0, 0] + covariances[:, 1, 1]))
        assert told["median_sigma_m"] == pytest.approx(np.median(sigmas_m))

    def test_of_a_log_that_is_no_map_there_is_none(self, dslam: Run, folder: Path) -> None:
        assert "map" not in json.loads(dslam("info", folder / "out.mcap", "--json").out)
        assert "to localize in it" not in dslam("info", folder / "out.mcap").out

    def test_says_why_a_map_cannot_be_used(self, dslam: Run, town: Path, tmp_path: Path) -> None:
        path = rewritten(tmp_path / "m.mcap", town, {"format_version": "9"})
        result = dslam("info", path)
        assert result.code == 0
        assert "cannot be used" in result.out
        assert "version 9, this program reads 1" in " ".join(result.out.split())
        told = json.loads(dslam("info", path, "--json").out)["map"]
        assert (told["usable"], "format version 9" in told["fault"]) == (False, True)


def rewritten(path: Path, source: Path, metadata: dict[str, str], *, topics: tuple[str, ...] = ("/map/",)) -> Path:
    """The map with other metadata, and only the topics that begin with one of those."""
    with LogWriter(path) as writer:
        writer.add_metadata(METADATA, {"format_version": "1", "gravity": GRAVITY, **metadata})
        for message in raw_messages(source):
            if message.topic.startswith(topics):
                writer.write_raw(message)
    return path


class TestBadMaps:
    """Each is refused in one line, whoever is given it, and before any output is begun."""

    @pytest.mark.parametrize(
        ("kind", "told"),
        [
            ("missing", ("cannot read", "check the path")),
            ("truncated", ("damaged",)),
            ("log", ("is a log, but no map", "--save-map")),
            ("output", ("is a log, but no map", "--save-map")),
            ("version", ("format version 9", "this program reads 1")),
            ("gravity", ("does not hold the direction of gravity",)),
            ("empty", ("holds 0 object maps and 0 graphs",)),
            ("drives", ("list of drives",)),
        ],
    )
    def test_one_line(self, dslam: Run, folder: Path, town: Path, tmp_path: Path, kind: str, told: tuple[str]) -> None:
        path, whole = tmp_path / "bad.mcap", town.read_bytes()
        match kind:
            case "truncated":
                path.write_bytes(whole[: len(whole) // 2])
            case "log":
                path = folder / "first.mcap"
            case "output":
                path = folder / "out.mcap"
            case "version":
                rewritten(path, town, {"format_version": "9"})
            case "gravity":
                rewritten(path, town, {"gravity": ""})
            case "empty":
                rewritten(path, town, {}, topics=("/none",))
            case "drives":
                rewritten(path, town, {"drives": "[1"})
        output = tmp_path / "out.mcap"
        for command in ("relocalize", "replay"):
            result = dslam(command, folder / "second.mcap", "-o", output, "--map", path)
            assert_refused(result, str(path), *told)
        assert sorted(each.name for each in tmp_path.glob("out*")) == []

    def test_a_map_is_no_log(self, dslam: Run, town: Path, tmp_path: Path) -> None:
        output = tmp_path / "out.mcap"
        assert_refused(dslam("replay", town, "-o", output), "is a saved map, not a drive", "--map")
        assert_refused(dslam("relocalize", town, "--map", town, "-o", output), "is a saved map, not a drive", "--map")
        assert not output.exists()
