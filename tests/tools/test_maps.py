"""Saved maps by the command line: made, described, found oneself in, and refused."""

from pathlib import Path

import pytest
from foxglove_schemas_protobuf.PointCloud_pb2 import PointCloud

from logs.writer import LogWriter
from slam.library import read_map
from slam.object_map.map_io import METADATA, POINTS_TOPIC
from tests.helpers.short_drives import raw_messages, records_of
from tests.tools.runs import Run, assert_refused, assert_well, loaded_by, run_well

pytestmark = pytest.mark.slow


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Two drives along one street, one through another town, and the map of the first one."""
    folder = tmp_path_factory.mktemp("maps")
    simulate = ("simulate", "--length", 120)
    for name, more in (("first", ()), ("second", ("--set", "sensor.dropout=0.2")), ("other", ("--seed", 7))):
        run_well(*simulate, folder / f"{name}.mcap", *more)
    run_well("replay", folder / "first.mcap", "-o", folder / "out.mcap", "--save-map", folder / "map.mcap")
    return folder


@pytest.fixture
def town(folder: Path) -> Path:
    return folder / "map.mcap"


def test_relocalize_finds_the_robot(dslam: Run, folder: Path, town: Path, tmp_path: Path) -> None:
    before, output = town.read_bytes(), tmp_path / "found.mcap"
    command = ("relocalize", folder / "second.mcap", "--map", town, "-o", output)
    result = assert_well(dslam(*command, "--picture", output.with_suffix(".png")))
    assert all(name in result.out for name in ("found", "recognised", "tracked"))
    assert output.with_suffix(".png").read_bytes().startswith(b"\x89PNG")
    closures = [closure for closure in records_of(output, "/slam/closures") if closure.accepted]
    assert len(closures) > 20
    assert min(pose.stamp_ns for pose in records_of(output, "/slam/pose")) >= closures[0].stamp_ns
    found = dslam("evaluate", output, "--map-run", folder / "out.mcap", "--json").json["relocalization"]
    assert found["success_rate"] == 1.0
    assert found["median_error_m"] < 1.0
    told = dslam(*command, "--set", "loop_closure.descriptor=gosmatch_vertex", "--json").json
    assert told["found"] is True
    assert 0.5 < told["tracked_ratio"] < 1.0
    assert town.read_bytes() == before


def test_relocalize_in_another_town_ends_with_1(dslam: Run, folder: Path, town: Path, tmp_path: Path) -> None:
    output, picture = tmp_path / "out.mcap", tmp_path / "lost.png"
    result = dslam("relocalize", folder / "other.mcap", "--map", town, "-o", output, "--picture", picture)
    assert result.code == 1
    assert "never: no place of the map was recognised" in result.out
    assert not picture.exists()
    assert records_of(output, "/slam/pose") == []


@pytest.mark.parametrize("near", ["1,2", "1,2,nan"])
def test_relocalize_refuses_places_that_are_no_numbers(dslam: Run, folder: Path, tmp_path: Path, near: str) -> None:
    command = ("relocalize", folder / "second.mcap", "--map", folder / "map.mcap", "-o", tmp_path / "out.mcap")
    assert_refused(dslam(*command, f"--near={near}"), repr(near), "X,Y,SIGMA or X,Y,YAW,SIGMA")


def test_replay_extends_the_map_only_where_it_is_recognised(
    dslam: Run, folder: Path, town: Path, tmp_path: Path
) -> None:
    grown, output = tmp_path / "grown.mcap", tmp_path / "out.mcap"
    more = ("--map", town, "--save-map", grown)
    refused = dslam("replay", folder / "other.mcap", "-o", output, *more)
    assert_refused(refused, "never relocalized", "was not written")
    assert not grown.exists()
    assert dslam("replay", folder / "second.mcap", "-o", output, *more).code == 0
    before, after = (dslam("info", path, "--json").json["map"] for path in (town, grown))
    assert after["landmark_count"] <= 1.05 * before["landmark_count"]
    assert after["path_m"] == pytest.approx(2 * before["path_m"], rel=0.1)
    assert len(after["drives"]) == 2


@pytest.mark.parametrize("kind", ["saved", "imported"])
def test_every_kind_of_map_is_shown_viewed_and_exported(dslam: Run, town: Path, tmp_path: Path, kind: str) -> None:
    map_log = town
    if kind == "imported":
        (tmp_path / "objects.csv").write_text("x_m,y_m,label\n0,0,tree\n5,0,pole\n0,7,tree\n6,8,tree\n")
        map_log = tmp_path / "imported.mcap"
        assert dslam("import", "map", map_log, "--file", tmp_path / "objects.csv").code == 0
    count = len(read_map(map_log).ids)
    shown = dslam("info", map_log).text
    assert f"landmark count {count}" in shown
    assert "this is a saved map, not a drive" in shown
    assert dslam("info", map_log, "--json").json["map"]["landmark_count"] == count
    table, picture = tmp_path / "map.csv", tmp_path / "map.png"
    assert dslam("export", map_log, "--csv", table).code == 0
    assert len(table.read_text().splitlines()) == count + 1
    assert dslam("view", map_log, "--save", picture).code == 0
    assert picture.read_bytes().startswith(b"\x89PNG")
    (points,) = raw_messages(map_log, POINTS_TOPIC)
    cloud = PointCloud.FromString(points.data)
    assert len(cloud.data) == count * cloud.point_stride


def test_no_solver_is_loaded_to_look_into_a_map(town: Path) -> None:
    heavy = "gtsam scipy torch matplotlib slam.localization slam.common.config"
    assert loaded_by(f"from tools.cli import run; run(['info', {str(town)!r}])", heavy) == ""


def rewritten(path: Path, source: Path, metadata: dict[str, str]) -> Path:
    """The map with other metadata."""
    with LogWriter(path) as writer:
        writer.add_metadata(METADATA, {"format_version": "1", **metadata})
        for message in raw_messages(source):
            writer.write_raw(message)
    return path


def test_bad_maps_are_refused_in_one_line(dslam: Run, folder: Path, town: Path, tmp_path: Path) -> None:
    """What is wrong with a file is tested in tests/slam/object_map."""
    path, output = rewritten(tmp_path / "bad.mcap", town, {"format_version": "9"}), tmp_path / "out.mcap"
    for command in ("relocalize", "replay"):
        refuse = (command, folder / "second.mcap", "-o", output, "--map")
        assert_refused(dslam(*refuse, path), str(path), "format version 9", "this program reads 1")
        assert_refused(dslam(*refuse, folder / "out.mcap"), "is a log, but no map", "--save-map")
        assert_refused(dslam(*refuse, tmp_path / "none.mcap"), "cannot read", "check the path")
    assert "cannot be used" in dslam("info", path).out
    damaged = rewritten(path, town, {"drives": "[1"})
    assert "list of drives" in dslam("info", damaged, "--json").json["map"]["fault"]
    assert_refused(dslam("replay", town, "-o", output), "is a saved map, not a drive", "--map")
    assert_refused(dslam("relocalize", folder / "second.mcap", "--map", town, "-o", town), "is the input")
    assert not list(tmp_path.glob("out*"))
