"""Whole fleets of short drives through the generated town: slow, as each log is mapped."""

from __future__ import annotations

import os
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from slam.common.config import Config
from slam.common.errors import FleetError, SavedMapError
from slam.fleet.fleet import Fleet, map_fleet
from slam.fleet.logs import FleetLog
from slam.fleet.report import fleet_report, write_report
from slam.fleet.sessions import SessionTask, map_session
from slam.fleet.tasks import compute_in_processes
from slam.library import read_map
from slam.place_recognition.imported_map import load_imported_map
from slam.simulation.config import SimulationConfig
from slam.simulation.simulation import write_simulation
from tests.helpers.driven_maps import drive_poses, town

pytestmark = pytest.mark.slow

OUTPUTS = ("map.mcap", "changes.geojson", "report.json")
SLOW = {"OMP_NUM_THREADS": "1"}


def compute_inline(function: Callable[[Any], Any], tasks: Sequence[Any]) -> Iterator[tuple[Any, Any]]:
    """In this process, the last task first."""
    yield from ((task, function(task)) for task in reversed(tasks))


def write_drive(path: Path, from_m: float, to_m: float, seed: int, *, town_seed: int = 1) -> None:
    world = town(town_seed)
    tour = drive_poses(world, from_m, to_m)[:, :2, 3]
    write_simulation(path, replace(world, tour=tour), SimulationConfig(), seed=seed)


@pytest.fixture(scope="module")
def logs(tmp_path_factory: pytest.TempPathFactory) -> list[FleetLog]:
    folder = tmp_path_factory.mktemp("logs")
    write_drive(folder / "a.mcap", 0.0, 130.0, 0)
    write_drive(folder / "b.mcap", 160.0, 30.0, 1)
    write_drive(folder / "other.mcap", 0.0, 130.0, 2, town_seed=7)
    (folder / "again.mcap").write_bytes((folder / "a.mcap").read_bytes())
    (folder / "broken.mcap").write_bytes((folder / "a.mcap").read_bytes()[:5000])
    return [FleetLog(name, folder / f"{name}.mcap") for name in ("a", "b", "other", "again", "broken")]


def run(logs: list[FleetLog], folder: Path, compute: Any) -> Fleet:
    folder.mkdir(exist_ok=True)
    fleet = map_fleet(logs, folder, Config(), compute)
    write_report(folder, fleet)
    return fleet


@pytest.fixture(scope="module")
def mapped(logs: list[FleetLog], tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Fleet]:
    folder = tmp_path_factory.mktemp("fleet")
    return folder, run(logs, folder, compute_inline)


def same_bytes(folder: Path, other: Path) -> bool:
    return all((folder / name).read_bytes() == (other / name).read_bytes() for name in OUTPUTS)


def test_every_log_is_accounted_for(mapped: tuple[Path, Fleet]) -> None:
    report = fleet_report(mapped[1])
    status = {log["log"]: log["status"] for log in report["logs"]}
    assert status == {
        "a": "joined",
        "b": "joined",
        "other": "alone",
        "again": "repeated",
        "broken": "not mapped",
    }
    assert all(log["reason"] for log in report["logs"] if log["status"] != "joined")
    assert [part["logs"] for part in report["parts"]] == [2]


def test_the_map_has_tiles_and_opens_as_any_other(mapped: tuple[Path, Fleet]) -> None:
    folder, fleet = mapped
    tiles = load_imported_map(folder / "map.mcap")
    assert len(tiles) == np.count_nonzero(fleet.living[0].presence.present >= 0.5)
    objects = read_map(folder / "map.mcap")
    assert set(objects.ids) == set(tiles.objects.ids)
    assert objects.observation_counts.min() > 0


def test_one_or_two_workers_give_the_same_bytes(
    logs: list[FleetLog], mapped: tuple[Path, Fleet], tmp_path: Path
) -> None:
    run(logs, tmp_path / "two", partial(compute_in_processes, workers=2))
    assert same_bytes(mapped[0], tmp_path / "two")


def test_what_is_done_is_not_done_again(logs: list[FleetLog], mapped: tuple[Path, Fleet]) -> None:
    folder, _ = mapped
    before = {name: (folder / name).read_bytes() for name in OUTPUTS}

    def compute_nothing(function: Callable[[Any], Any], tasks: Sequence[Any]) -> Iterator[tuple[Any, Any]]:
        assert not tasks
        return iter(())

    run(logs, folder, compute_nothing)
    assert before == {name: (folder / name).read_bytes() for name in OUTPUTS}


def test_a_killed_driver_goes_on_where_it_was(logs: list[FleetLog], mapped: tuple[Path, Fleet], tmp_path: Path) -> None:
    code = (
        "from pathlib import Path; from functools import partial; from slam.common.config import Config;"
        "from slam.fleet.fleet import map_fleet; from slam.fleet.logs import FleetLog;"
        "from slam.fleet.tasks import compute_in_processes\n"
        "if __name__ == '__main__':\n"
        f"    logs = [FleetLog(n, Path(p)) for n, p in {[(log.name, str(log.path)) for log in logs]!r}]\n"
        f"    map_fleet(logs, Path({str(tmp_path)!r}), Config(), partial(compute_in_processes, workers=1))\n"
    )
    script = tmp_path / "drive.py"
    script.write_text(code)
    driver = subprocess.Popen([sys.executable, str(script)], env={**os.environ, **SLOW})
    try:
        while not list(tmp_path.glob("sessions/*/session.json")) and driver.poll() is None:
            time.sleep(0.05)
    finally:
        driver.send_signal(signal.SIGKILL)
        driver.wait()
    assert not (tmp_path / "map.mcap").exists()
    finished = {path: path.stat().st_mtime_ns for path in tmp_path.glob("sessions/*/session.json")}
    run(logs, tmp_path, compute_inline)
    assert same_bytes(mapped[0], tmp_path)
    assert not list(tmp_path.glob("sessions/*/mapping-*"))
    assert finished == {path: path.stat().st_mtime_ns for path in finished}


def test_folded_sessions_give_the_same_map_night_by_night_and_at_once(
    logs: list[FleetLog], mapped: tuple[Path, Fleet], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("slam.fleet.fleet.BLOCK", 1)
    for folder in ("nights", "once"):
        shutil.copytree(mapped[0] / "sessions", tmp_path / folder / "sessions")
    for night in range(1, len(logs) + 1):
        run(logs[:night], tmp_path / "nights", compute_inline)
    fleet = run(logs, tmp_path / "once", compute_inline)
    assert same_bytes(tmp_path / "nights", tmp_path / "once")
    assert fleet.parts[0].sessions == mapped[1].parts[0].sessions
    assert len(fleet.parts[0].objects.ids) == len(mapped[1].parts[0].objects.ids)
    np.testing.assert_allclose(
        np.sort(fleet.parts[0].objects.positions, axis=0),
        np.sort(mapped[1].parts[0].objects.positions, axis=0),
        atol=0.05,
    )


def test_a_fleet_in_which_nothing_can_be_mapped_is_refused(logs: list[FleetLog], tmp_path: Path) -> None:
    with pytest.raises(FleetError, match="none of 1 logs"):
        map_fleet([log for log in logs if log.name == "broken"], tmp_path, Config(), compute_inline)


def test_why_a_log_has_no_map_is_told_by_the_same_bytes_each_time(
    logs: list[FleetLog], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def refuse(log: Path, output: Path, config: Config, *, map_path: Path) -> None:
        raise SavedMapError(f"{map_path} was not written")

    monkeypatch.setattr("slam.fleet.sessions.replay", refuse)
    told = [map_session(SessionTask(logs[0].path, "0", Config(), tmp_path / name)) for name in ("a", "b")]
    assert told[0].reason == "map.mcap was not written"
    assert told[0] == told[1]
