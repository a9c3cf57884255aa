"""Maps that are at odds with themselves are refused, each in one line that says what is wrong."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from slam.common.config import Config
from slam.common.errors import SavedMapError
from slam.object_map.map_io import SavedMap, confirmed, load_map
from slam.object_map.map_validation import parts
from slam.simulation.config import SimulationConfig
from tests.helpers.short_drives import drive, keep_until, map_in_memory, write_map


@pytest.fixture(scope="module")
def known() -> SavedMap:
    final = map_in_memory(keep_until(drive(SimulationConfig()), 12.0), Config()).finish()
    return SavedMap(confirmed(final.object_map), final.graph)


def set_first(values, value):
    """A copy with another first entry."""
    if isinstance(values, tuple):
        return (value, *values[1:])
    changed = values.copy()
    changed[0] = value
    return changed


OBJECT_FAULTS = {
    "landmark 1 is in it more than once": lambda o: replace(o, ids=("1", *o.ids[1:])),
    "class bench is in it more than once": lambda o: replace(o, vocabulary=("bench",) * len(o.vocabulary)),
    "is not confirmed": lambda o: replace(o, states=set_first(o.states, "tentative")),
    "damaged": lambda o: replace(o, positions=set_first(o.positions, np.nan)),
    "has a matrix that is not a covariance": lambda o: replace(o, covariances=set_first(o.covariances, -np.eye(3))),
    "class probabilities": lambda o: replace(o, class_probabilities=0.5 * o.class_probabilities),
    "was never seen": lambda o: replace(o, observation_counts=set_first(o.observation_counts, 0)),
}
GRAPH_FAULTS = {
    "keyframe 1 is in it more than once": lambda g: replace(g, keyframe_ids=set_first(g.keyframe_ids, 1)),
    "an edge of its graph ends at keyframe 4000": lambda g: replace(
        g, edge_keyframe_ids=set_first(g.edge_keyframe_ids, [0, 4000])
    ),
    "leads from keyframe 0 to itself": lambda g: replace(g, edge_keyframe_ids=set_first(g.edge_keyframe_ids, [0, 0])),
    "observes from keyframe 4000": lambda g: replace(
        g, observation_keyframe_ids=set_first(g.observation_keyframe_ids, 4000)
    ),
    "observes landmark 4000, which it does not have": lambda g: replace(
        g, observation_landmark_ids=set_first(g.observation_landmark_ids, "4000")
    ),
    "of an unknown kind 'magic'": lambda g: replace(g, edge_kinds=set_first(g.edge_kinds, "magic")),
    "edge 0 -> 1 of its graph has a covariance that is not positive definite": lambda g: replace(
        g, edge_covariances=set_first(g.edge_covariances, np.zeros((6, 6)))
    ),
    "with a covariance that is not positive definite": lambda g: replace(
        g, observation_covariances=set_first(g.observation_covariances, -np.eye(3))
    ),
    "an observation without a positive covariance inflation": lambda g: replace(
        g, observation_redundancies=set_first(np.ones(len(g.observation_positions)), 0.0)
    ),
    "no edge connects keyframe 1 to the first one": lambda g: replace(
        g,
        edge_keyframe_ids=g.edge_keyframe_ids[:0],
        edge_transforms=g.edge_transforms[:0],
        edge_covariances=g.edge_covariances[:0],
        edge_kinds=(),
    ),
}


def refusal(path: Path) -> str:
    with pytest.raises(SavedMapError) as refused:
        load_map(path)
    assert "\n" not in str(refused.value)
    assert str(refused.value).startswith(str(path))
    return str(refused.value)


@pytest.mark.parametrize("fault", OBJECT_FAULTS)
def test_landmarks_that_do_not_fit_together_are_refused(known: SavedMap, tmp_path: Path, fault: str) -> None:
    assert fault in refusal(write_map(tmp_path / "m.mcap", OBJECT_FAULTS[fault](known.objects), known.graph))


@pytest.mark.parametrize("fault", GRAPH_FAULTS)
def test_a_graph_that_does_not_fit_together_is_refused(known: SavedMap, tmp_path: Path, fault: str) -> None:
    assert fault in refusal(write_map(tmp_path / "m.mcap", known.objects, GRAPH_FAULTS[fault](known.graph)))


def test_two_maps_in_one_file_are_refused(known: SavedMap, tmp_path: Path) -> None:
    path = write_map(tmp_path / "m.mcap", known.objects, known.graph, twice=True)
    assert "holds 2 object maps and 1 graphs" in refusal(path)


def test_observations_of_keyframes_that_were_summed_up_may_have_less_than_one_as_redundancy(
    known: SavedMap, tmp_path: Path
) -> None:
    graph = replace(known.graph, observation_redundancies=np.full(len(known.graph.observation_positions), 0.5))
    assert load_map(write_map(tmp_path / "m.mcap", known.objects, graph)).objects.ids == known.objects.ids


@given(st.permutations(range(9)), st.lists(st.tuples(st.integers(0, 8), st.integers(0, 8)), max_size=20))
def test_a_part_has_the_name_of_its_first_row(ids, pairs):
    rows = np.array(pairs, dtype=np.int64).reshape(-1, 2)
    graph: Any = SimpleNamespace(keyframe_ids=np.array(ids), edge_keyframe_ids=np.array(ids)[rows])
    reached = np.eye(9, dtype=np.bool_)
    reached[rows[:, 0], rows[:, 1]] = reached[rows[:, 1], rows[:, 0]] = True
    for _ in range(4):
        reached = reached @ reached
    np.testing.assert_array_equal(parts(graph, np.ones(len(rows), dtype=np.bool_)), reached.argmax(axis=1))
