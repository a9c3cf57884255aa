"""Maps that last: what is saved comes back, a robot finds itself in it, and what is no map is refused."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from logs.errors import LogError
from logs.messages import SlamPose, StatusRecord
from logs.writer import LogWriter
from slam.config import Config
from slam.errors import SavedMapError
from slam.replay import replay
from slam.saved_map import METADATA, SavedMap, confirmed, load_map, save_map
from slam.simulation.config import SimulationConfig
from slam.system import FinalMap, Slam, State
from tests.short_drives import Entry, block_world, drive, records_of, write_log

PROVENANCE = {"version": "test"}


def mapped(entries: list[Entry], earlier: SavedMap | None = None, *, extend: bool = True) -> tuple[Slam, FinalMap]:
    slam = Slam(Config(), earlier, extend=extend)
    for _, _, record in entries:
        slam.process(record)
    return slam, slam.finish()


def second_block():
    world = block_world()
    rng = np.random.default_rng(99)
    positions = world.positions + np.column_stack(
        [rng.uniform(-9.0, 9.0, (len(world.labels), 2)), np.zeros(len(world.labels))]
    )
    return replace(world, positions=positions, labels=tuple(rng.permutation(list(world.labels)).tolist()))


@pytest.fixture(scope="module")
def first() -> FinalMap:
    return mapped(drive(SimulationConfig(), seed=1))[1]


@pytest.fixture(scope="module")
def known(first: FinalMap) -> SavedMap:
    return SavedMap(confirmed(first.object_map), first.graph)


@pytest.fixture
def path(first: FinalMap, tmp_path: Path) -> Path:
    target = tmp_path / "map.mcap"
    save_map(target, first.object_map, first.graph, first.markers, PROVENANCE)
    return target


def test_what_was_saved_comes_back(path: Path, known: SavedMap) -> None:
    loaded = load_map(path)
    assert loaded.objects.ids == known.objects.ids
    assert set(loaded.objects.states) == {"confirmed"}
    for name in ("positions", "covariances", "class_probabilities", "observation_counts"):
        np.testing.assert_array_equal(getattr(loaded.objects, name), getattr(known.objects, name))
    for name in ("keyframe_ids", "T_map_body", "edge_transforms", "observation_positions", "observation_covariances"):
        np.testing.assert_allclose(getattr(loaded.graph, name), getattr(known.graph, name), atol=1e-12)


def test_a_robot_finds_itself_in_the_map_and_is_lost_until_then(known: SavedMap) -> None:
    slam = Slam(Config(), known)
    assert slam.state == State.LOST
    states: list[str] = []
    poses_while_lost = 0
    for _, _, record in drive(SimulationConfig(), seed=2):
        for update in slam.process(record):
            if isinstance(update, StatusRecord):
                states.append(update.state)
            poses_while_lost += isinstance(update, SlamPose) and not slam.fixes
    final = slam.finish()
    assert [state for place, state in enumerate(states) if place == 0 or state != states[place - 1]] == [
        "LOST",
        "RELOCALIZED",
        "TRACKING",
    ]
    assert poses_while_lost == 0
    assert slam.fixes[0].travel_m < 60.0
    landmarks = final.object_map.states.count("confirmed")
    assert landmarks == pytest.approx(len(known.objects.ids), rel=0.1)


def test_the_pose_in_the_map_is_right(known: SavedMap) -> None:
    # Both drives follow one tour, so the same place along it is the same place in the map.
    final = mapped(drive(SimulationConfig(), seed=3), known)[1]
    middle = len(final.trajectory.stamps_ns) // 2
    again = mapped(drive(SimulationConfig(), seed=1))[1]
    T_error = np.linalg.inv(again.trajectory.T_map_body[middle]) @ final.trajectory.T_map_body[middle]
    assert np.linalg.norm(T_error[:2, 3]) < 0.5
    assert abs(np.arctan2(T_error[1, 0], T_error[0, 0])) < np.deg2rad(2.0)


def test_a_map_that_is_not_extended_stays_where_it_was(known: SavedMap) -> None:
    _, final = mapped(drive(SimulationConfig(), seed=2), known, extend=False)
    kept = final.graph.T_map_body[: len(known.graph.keyframe_ids)]
    assert np.abs(kept - known.graph.T_map_body).max() < 0.02


def test_twin_in_another_town_the_robot_stays_lost(known: SavedMap) -> None:
    slam, final = mapped(drive(SimulationConfig(), seed=2, world=second_block()), known)
    assert slam.state == State.LOST
    assert slam.fixes == []
    assert final.object_map.states.count("confirmed") > len(known.objects.ids)


def test_a_drive_without_a_map_never_leaves_mapping() -> None:
    slam, _ = mapped(drive(SimulationConfig(), seed=2))
    assert slam.state == State.MAPPING
    assert slam.counters["kidnappings_noticed"] == 0


def test_the_same_drive_in_the_same_map_gives_the_same_bytes(path: Path, tmp_path: Path) -> None:
    log = write_log(tmp_path / "in.mcap", drive(SimulationConfig(), seed=2))
    outputs = []
    for name in ("a", "b"):
        replay(log, tmp_path / f"{name}.mcap", Config(), earlier=load_map(path), map_path=tmp_path / f"{name}_map.mcap")
        outputs.append((tmp_path / f"{name}.mcap").read_bytes() + (tmp_path / f"{name}_map.mcap").read_bytes())
    assert outputs[0] == outputs[1]
    assert len(records_of(tmp_path / "a.mcap", "/slam/relocalizations")) > 0
    assert len(load_map(tmp_path / "a_map.mcap").objects.ids) > 0


def test_a_log_is_no_map(path: Path, tmp_path: Path) -> None:
    log = write_log(tmp_path / "in.mcap", drive(SimulationConfig(), seed=2))
    with pytest.raises(SavedMapError, match=r"in.mcap is a log, but no map; make one by"):
        load_map(log)


@pytest.mark.parametrize("share", [0.1, 0.3, 0.6])
def test_half_a_map_is_none(path: Path, share: float) -> None:
    whole = path.read_bytes()
    path.write_bytes(whole[: int(share * len(whole))])
    with pytest.raises((SavedMapError, LogError)):
        load_map(path)


@pytest.mark.parametrize(
    ("change", "reason"),
    [
        ({"format_version": "7"}, "format version 7"),
        ({"gravity": "down"}, "which way is up"),
    ],
)
def test_another_format_is_refused(first: FinalMap, tmp_path: Path, change: dict[str, str], reason: str) -> None:
    target = tmp_path / "other.mcap"
    with LogWriter(target) as writer:
        writer.add_metadata(METADATA, {"format_version": "1", "gravity": "z of the frame map points up", **change})
        writer.write("/map/objects", confirmed(first.object_map), 0)
        writer.write("/map/graph", first.graph, 0)
    with pytest.raises(SavedMapError, match=reason):
        load_map(target)


def test_an_empty_map_is_refused(first: FinalMap, tmp_path: Path) -> None:
    nothing = replace(first.object_map, states=("retired",) * len(first.object_map.ids))
    save_map(tmp_path / "empty.mcap", nothing, first.graph, first.markers, PROVENANCE)
    with pytest.raises(SavedMapError, match="without landmarks"):
        load_map(tmp_path / "empty.mcap")
