"""Every command and program of README and guides, run with the wheel where the files of its page are."""

import csv
import re
import shutil
from collections.abc import Iterable
from operator import itemgetter
from pathlib import Path

import pytest
from rosbags.typesys import get_types_from_msg

from logs.decoders.ros2_types import TYPES
from logs.messages import ObjectDetections
from logs.reader import LogReader
from logs.selection import select_topics
from tests.helpers.loop_drives import one_block
from tests.helpers.ros2_logs import header, ros2_messages, vector, write_bag
from tests.helpers.short_drives import records_of
from tests.test_docs import blocks_of, commands
from tests.tools.runs import ROOT, Run, run_well, text_of

pytestmark = pytest.mark.slow

PAGES = ["README.md", *(f"docs/{page.name}" for page in sorted((ROOT / "docs").glob("*.md")))]
COMMANDS = {page: [each for block in blocks_of(page) for each in commands(block)] for page in PAGES}
CODE = {
    f"{Path(page).stem}-{number}": block
    for page in PAGES
    for number, block in enumerate(re.findall(r"```python\n(.*?)```", text_of(page), re.DOTALL))
}
SHORTER = {
    "simulate": ("--length", "120"),
    "sweep": ("--seeds", "1", "--jobs", "1"),
    "benchmark descriptors": ("--queries", "2"),
}
"""Of an option that comes twice, the last one counts."""
ELSEWHERE = {
    r"import map .*\.osm": "pyosmium may not be here; tests/logs/importers/maps",
    r"mine:Rings": "tests/descriptors/test_own_class.py has the class of the page",
    r"my_bag .*(labelled_points|/front/objects)": "such topics are in tests/logs/test_ros2_objects.py and clouds",
    r"^live ": "serves until its input ends; tests/tools/test_live.py",
    r"relocalize .*trees_map|places.csv": "the drives have no satellite fixes; tests/slam/localization/test_gnss.py",
    r"^train|out/mine": "takes minutes; tests/tools/test_train.py",
}
"""Commands that are run by other tests, and where."""


def runnable(page: str) -> list[list[str]]:
    """The commands of a page that no other test runs."""
    return [each for each in COMMANDS[page] if not any(re.search(known, " ".join(each)) for known in ELSEWHERE)]


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Two drives through one town under all names that pages give to drives, and what becomes of them."""
    folder = tmp_path_factory.mktemp("pages")
    drive, tuesday = folder / "drive.mcap", folder / "tuesday.mcap"
    world = one_block()
    rows = zip(world.positions.tolist(), world.labels, world.object_ids, strict=True)
    write_table(folder / "world.csv", ["x_m", "y_m", "z_m", "class", "id"], ([*at, *of] for at, *of in rows))
    write_table(folder / "tour.csv", ["x_m", "y_m"], world.tour.tolist())
    town = ("--objects", folder / "world.csv", "--trajectory", folder / "tour.csv")
    simulate = ("simulate", *town, "--set", "drive.rate_hz=5")
    run_well(*simulate, drive)
    run_well(*simulate, tuesday, "--length", 120, "--set", "sensor.dropout=0.3")
    for source, output, saved in ((drive, "map.mcap", "town.mcap"), (tuesday, "b1.mcap", "harbour.mcap")):
        run_well("replay", source, "-o", folder / output, "--save-map", folder / saved)
    for name, setting in (("a2", "1.9"), ("a3", "1.8"), ("b2", "1.7"), ("b3", "1.6")):
        run_well("replay", tuesday, "-o", folder / f"{name}.mcap", "--set", f"keyframe.distance_m={setting}")
    for seed, day in enumerate(("monday", "wednesday", "thursday", "friday"), start=1):
        run_well(*simulate, folder / f"{day}.mcap", "--length", 120, "--seed", seed)
    shutil.copy(drive, folder / "mine.mcap")
    for copy in ("saved.mcap", "map_saved.mcap"):
        shutil.copy(folder / "town.mcap", folder / copy)
    shutil.copy(folder / "map.mcap", folder / "a1.mcap")
    export = ("export", folder / "map.mcap")
    for name in ("gt.tum", "truth.tum", "00.txt", "consistent.txt"):
        kind = "--tum" if name.endswith("tum") else "--kitti"
        run_well(*export, "--of", "truth", kind, folder / name)
    run_well(*export, "--of", "odometry", "--tum", folder / "odometry.tum")
    run_well(*export, "--geojson", folder / "trees.geojson", "--origin", "60.17,24.94")
    (folder / "calib.txt").write_text("Tr: 1 0 0 0 0 1 0 0 0 0 1 0\n", encoding="utf-8")
    run_well(*export, "--csv", folder / "objects.csv")
    write_detections(folder / "detections.csv", drive)
    write_bags(folder, drive)
    (folder / "out").mkdir()
    return folder


def write_detections(path: Path, drive: Path) -> None:
    rows = (
        [scan.stamp_ns, *at, label]
        for scan in records_of(drive, "/detections")
        if isinstance(scan, ObjectDetections)
        for at, label in zip(scan.positions.tolist(), scan.labels, strict=True)
    )
    write_table(path, ["stamp_ns", "x_m", "y_m", "z_m", "label"], rows)


def write_bags(folder: Path, drive: Path) -> None:
    """The drive as ROS 2 records it, twice, and with detections in messages of another schema."""
    plant = "string kind\nfloat32 sure\ngeometry_msgs/Point position"
    for name, text in (("Crop", plant), ("Crops", "std_msgs/Header header\nfarm_msgs/Crop[] plants")):
        TYPES.register(get_types_from_msg(text, f"farm_msgs/msg/{name}"))
    with LogReader(drive) as log:
        entries = list(log.records(select_topics(log.topics())))
    messages = ros2_messages(entries)
    for name in ("my_bag", "tomorrow_bag"):
        write_bag(folder / name, messages)
    farm = [message for message in messages if message[0] == "/odom"]
    for _, log_time_ns, seen in entries:
        if isinstance(seen, ObjectDetections):
            at = zip(seen.labels, seen.scores, seen.positions, strict=True)
            plants = [{"kind": label, "sure": score, "position": vector(*position)} for label, score, position in at]
            values = {"header": header(seen.stamp_ns, seen.frame_id), "plants": plants}
            farm.append(("/plants", "farm_msgs/msg/Crops", log_time_ns, values))
    write_bag(folder / "farm_bag", sorted(farm, key=itemgetter(2)))


def write_table(path: Path, header: list[str], rows: Iterable[Iterable[object]]) -> None:
    with path.open("w", encoding="utf-8", newline="") as file:
        csv.writer(file).writerows([header, *rows])


@pytest.mark.parametrize("page", [page for page in PAGES if runnable(page)])
def test_each_command_of_a_page_runs(
    dslam: Run, folder: Path, page: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    work = tmp_path / "work"
    shutil.copytree(folder, work)
    monkeypatch.chdir(work)
    for arguments in runnable(page):
        shorter = next((more for name, more in SHORTER.items() if " ".join(arguments).startswith(name)), ())
        result = dslam(*arguments, *shorter)
        assert result.code == 0, f"{arguments}: {result.err}"
    assert not list(work.glob("*.part"))


@pytest.mark.parametrize("name", CODE)
def test_each_program_of_a_page_runs(
    folder: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], name: str
) -> None:
    shutil.copytree(folder, tmp_path / "work")
    monkeypatch.chdir(tmp_path / "work")
    exec(compile(CODE[name], name, "exec"), {})
    assert ("[[" in capsys.readouterr().out) == ("ScanLocalizer" in CODE[name])  # it is found, and its pose printed
