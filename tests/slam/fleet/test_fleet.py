"""Whole fleets of short drives through the generated town: slow, as each log is mapped."""

import shutil
from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.spatial import cKDTree

from slam.common.config import Config
from slam.common.errors import FleetError
from slam.common.georeference import Georeference
from slam.fleet.fleet import Fleet, map_fleet, write_report
from slam.fleet.part import Part, load_parts
from slam.fleet.sessions import FleetLog, find_logs
from slam.library import read_map
from slam.place_recognition.imported_map import load_imported_map
from slam.simulation.config import SimulationConfig
from slam.simulation.simulation import write_simulation
from tests.helpers.driven_maps import drive_poses, town

pytestmark = pytest.mark.slow


def compute_inline(function: Callable[[Any], Any], tasks: Sequence[Any], **_: Any) -> Iterator[tuple[Any, Any]]:
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
    found = find_logs([str(folder / f"{name}.mcap") for name in ("a", "b", "other", "again", "broken")])
    return [replace(log, name=log.path.stem) for log in found]


def run(logs: list[FleetLog], folder: Path, *, workers: int = 0, georeference: Georeference | None = None) -> Fleet:
    """A fleet that is mapped in this process, or by so many workers."""
    folder.mkdir(exist_ok=True)
    with pytest.MonkeyPatch.context() as patch:
        if not workers:
            patch.setattr("slam.fleet.sessions.compute_all", compute_inline)
        fleet = map_fleet(logs, folder, Config(), workers=workers, georeference=georeference, tell=print)
    write_report(folder, fleet)
    return fleet


@pytest.fixture(scope="module")
def mapped(logs: list[FleetLog], tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Fleet]:
    folder = tmp_path_factory.mktemp("fleet")
    return folder, run(logs, folder)


def outputs(folder: Path) -> list[bytes]:
    return [(folder / name).read_bytes() for name in ("map.mcap", "changes.geojson", "report.json")]


def test_every_log_is_accounted_for(mapped: tuple[Path, Fleet]) -> None:
    report = write_report(*mapped)
    status = {log["log"]: log["status"] for log in report["logs"]}
    assert status == {"a": "joined", "b": "joined", "other": "alone", "again": "repeated", "broken": "not mapped"}
    assert all(log["reason"] for log in report["logs"] if log["status"] != "joined")
    assert [part["logs"] for part in report["parts"]] == [2]


def test_the_map_has_tiles_and_opens_as_any_other(mapped: tuple[Path, Fleet]) -> None:
    folder, fleet = mapped
    tiles = load_imported_map(folder / "map.mcap")
    assert len(tiles) == np.count_nonzero(fleet.maps[0].presence.present >= 0.5)
    objects = read_map(folder / "map.mcap")
    assert set(objects.ids) == set(tiles.objects.ids)
    assert objects.observation_counts.min() > 0


def test_one_or_two_workers_give_the_same_bytes(
    logs: list[FleetLog], mapped: tuple[Path, Fleet], tmp_path: Path
) -> None:
    run(logs, tmp_path / "two", workers=2)
    assert outputs(mapped[0]) == outputs(tmp_path / "two")


def test_origin_stays_until_another_log_begins_the_map(
    logs: list[FleetLog], mapped: tuple[Path, Fleet], tmp_path: Path
) -> None:
    shutil.copytree(mapped[0] / "sessions", tmp_path / "sessions")
    origin = Georeference(48.0, 11.0)
    fleet = run(logs[:2], tmp_path, georeference=origin)
    run(logs[:3], tmp_path)
    assert load_imported_map(tmp_path / "map.mcap").georeference == origin
    run([log for log in logs[:2] if log.sha256 != fleet.order[0]], tmp_path)
    assert load_imported_map(tmp_path / "map.mcap").georeference is None


def test_what_is_done_is_not_done_again(
    logs: list[FleetLog], mapped: tuple[Path, Fleet], monkeypatch: pytest.MonkeyPatch
) -> None:
    folder, _ = mapped
    before = outputs(folder)

    def refuse(*_: object, **__: object) -> None:
        raise AssertionError("it was done before")

    monkeypatch.setattr("slam.fleet.sessions.map_session", refuse)
    monkeypatch.setattr("slam.fleet.fleet.find_joins", refuse)
    run(logs, folder)
    assert outputs(folder) == before


def test_folded_sessions_give_the_same_map_night_by_night_and_at_once(
    logs: list[FleetLog], mapped: tuple[Path, Fleet], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("slam.fleet.fleet.BLOCK", 1)
    for folder in ("nights", "once"):
        shutil.copytree(mapped[0] / "sessions", tmp_path / folder / "sessions")
    for night in range(1, len(logs) + 1):
        run(logs[:night], tmp_path / "nights")
    fleet = run(logs, tmp_path / "once")
    assert outputs(tmp_path / "nights") == outputs(tmp_path / "once")
    loaded = list[Path]()

    def load(folder: Path) -> list[Part]:
        loaded.append(folder)
        return load_parts(folder)

    monkeypatch.setattr("slam.fleet.fleet.load_parts", load)
    run(logs, tmp_path / "nights")
    assert len(loaded) == 1  # of all that was folded the latest
    folded, unfolded = (each.maps[0].part for each in (fleet, mapped[1]))
    assert folded.sessions == unfolded.sessions
    assert len(folded.objects.ids) == len(unfolded.objects.ids)
    moved_m, same = cKDTree(unfolded.objects.positions).query(folded.objects.positions)
    assert sorted(same) == list(range(len(same)))
    sigmas_m = np.sqrt(np.trace(unfolded.objects.covariances[same], axis1=1, axis2=2))
    assert (moved_m < 0.25 * sigmas_m).all()


def test_a_fleet_in_which_nothing_can_be_mapped_is_refused(logs: list[FleetLog], tmp_path: Path) -> None:
    with pytest.raises(FleetError, match="none of 1 logs"):
        run([log for log in logs if log.name == "broken"], tmp_path)
