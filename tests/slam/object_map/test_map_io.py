"""Maps that last: what is saved comes back, a robot finds itself in it, and what is no map is refused."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from slam.common.config import Config
from slam.common.errors import SavedMapError
from slam.final_map import FinalMap
from slam.object_map.map_io import SavedMap, confirmed, load_map, save_map
from slam.replay import replay
from slam.simulation.config import SimulationConfig
from slam.system import Slam
from tests.helpers.graphs import with_edges
from tests.helpers.loop_drives import emptier
from tests.helpers.short_drives import Entry, block_world, drive, map_in_memory, write_log, write_map

pytestmark = pytest.mark.slow

PROVENANCE = {"version": "test"}


def mapped(entries: list[Entry], *prior_map: SavedMap, extend: bool = True) -> tuple[Slam, FinalMap]:
    slam = map_in_memory(entries, *prior_map, extend=extend)
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


@pytest.fixture(scope="module")
def second() -> list[Entry]:
    return drive(SimulationConfig(), seed=2)


@pytest.fixture(scope="module")
def kept(known: SavedMap, second: list[Entry]) -> tuple[Slam, FinalMap]:
    """The second drive, with the map of the first one as it was."""
    return mapped(second, known, extend=False)


@pytest.fixture(scope="module")
def elsewhere(known: SavedMap) -> tuple[Slam, FinalMap]:
    """A drive through another town, which goes on from the map all the same."""
    return mapped(drive(SimulationConfig(), seed=2, world=second_block()), known)


@pytest.fixture
def path(first: FinalMap, tmp_path: Path) -> Path:
    target = tmp_path / "map.mcap"
    save_map(target, first.object_map, first.graph, PROVENANCE)
    return target


def test_what_was_saved_comes_back(path: Path, known: SavedMap) -> None:
    loaded = load_map(path)
    assert loaded.objects.ids == known.objects.ids
    assert set(loaded.objects.states) == {"confirmed"}
    for name in ("positions", "covariances", "class_probabilities", "observation_counts"):
        np.testing.assert_array_equal(getattr(loaded.objects, name), getattr(known.objects, name))
    for name in ("keyframe_ids", "T_map_body", "edge_transforms", "observation_positions", "observation_covariances"):
        np.testing.assert_allclose(getattr(loaded.graph, name), getattr(known.graph, name), atol=1e-12)


def test_a_map_that_is_not_extended_stays_exactly_as_it_was(known: SavedMap, kept: tuple[Slam, FinalMap]) -> None:
    slam, final = kept
    assert slam.counters["closures_inserted"] > 1
    keyframes, landmarks = len(known.graph.keyframe_ids), len(known.objects.ids)
    np.testing.assert_array_equal(final.graph.T_map_body[:keyframes], known.graph.T_map_body)
    assert final.object_map.ids[:landmarks] == tuple(str(row) for row in range(landmarks))
    np.testing.assert_array_equal(final.object_map.positions[:landmarks], known.objects.positions)
    np.testing.assert_array_equal(final.object_map.covariances[:landmarks], known.objects.covariances)
    assert final.object_map.states[:landmarks] == known.objects.states
    assert final.object_map.labels[:landmarks] == known.objects.labels


@pytest.mark.parametrize("extend", [True, False])
def test_what_is_gone_is_retired_from_a_map_that_is_extended_and_from_no_other(known: SavedMap, extend: bool) -> None:
    _, final = mapped(drive(SimulationConfig(), seed=2, world=emptier(block_world())), known, extend=extend)
    gone = final.object_map.reasons.count("gone")
    assert gone >= 3 if extend else gone == 0


def test_an_empty_map_is_refused(first: FinalMap, tmp_path: Path) -> None:
    nothing = replace(first.object_map, states=("retired",) * len(first.object_map.ids))
    with pytest.raises(SavedMapError, match="no landmarks or no keyframes"):
        save_map(tmp_path / "empty.mcap", nothing, first.graph, PROVENANCE)
    assert not (tmp_path / "empty.mcap").exists()
    path = write_map(tmp_path / "empty.mcap", confirmed(nothing), first.graph)
    with pytest.raises(SavedMapError, match="no landmarks or no keyframes"):
        load_map(path)


# What is worth keeping


def test_a_map_that_stays_as_it_is_cannot_be_saved_again(
    path: Path, tmp_path: Path, second: list[Entry], kept: tuple[Slam, FinalMap]
) -> None:
    log = write_log(tmp_path / "in.mcap", second)
    target = tmp_path / "again.mcap"
    known = load_map(path)
    with pytest.raises(SavedMapError, match="does not change"):
        replay(log, tmp_path / "out.mcap", Config(), prior_map=known, extend=False, map_path=target)
    final = kept[1]
    with pytest.raises(SavedMapError, match="no edge connects keyframe 1 to the first one"):
        save_map(target, final.object_map, final.graph, PROVENANCE, earlier_drives=known.drives)
    assert not target.exists()


def test_a_stretch_that_nothing_ties_to_the_map_is_not_saved(
    known: SavedMap, tmp_path: Path, elsewhere: tuple[Slam, FinalMap]
) -> None:
    """The second drive is in another town: nobody knows where its landmarks are in the first one's map."""
    _, final = elsewhere
    path = tmp_path / "both.mcap"
    save_map(path, final.object_map, final.graph, PROVENANCE, earlier_drives=known.drives)
    loaded = load_map(path)
    assert len(loaded.graph.keyframe_ids) == len(known.graph.keyframe_ids) < len(final.graph.keyframe_ids)
    assert len(loaded.objects.ids) == len(known.objects.ids) < final.object_map.states.count("confirmed")
    np.testing.assert_allclose(loaded.objects.positions, known.objects.positions, atol=0.02)


@pytest.mark.parametrize(("kind", "scale", "left_out"), [("discontinuity", 1.0, 3), ("odometry", 1e6, 0)])
def test_a_discontinuity_is_known_by_its_kind_and_not_by_its_covariance(
    first: FinalMap, tmp_path: Path, kind: str, scale: float, left_out: int
) -> None:
    graph = with_edges(first.graph, np.flatnonzero(np.array(first.graph.edge_kinds) != "closure"))
    ids, row = graph.keyframe_ids, len(graph.keyframe_ids) - 4
    assert graph.edge_keyframe_ids[row].tolist() == [ids[-4], ids[-3]]
    kinds = (*graph.edge_kinds[:row], kind, *graph.edge_kinds[row + 1 :])
    covariances = graph.edge_covariances.copy()
    covariances[row] *= scale
    graph = replace(graph, edge_kinds=kinds, edge_covariances=covariances)
    save_map(tmp_path / "m.mcap", first.object_map, graph, PROVENANCE)
    assert len(load_map(tmp_path / "m.mcap").graph.keyframe_ids) == len(ids) - left_out
