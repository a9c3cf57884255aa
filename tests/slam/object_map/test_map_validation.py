"""Maps that are at odds with themselves are refused, each in one line that says what is wrong."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from slam.common.errors import SavedMapError
from slam.object_map.map_io import SavedMap, confirmed, load_map
from slam.object_map.map_validation import parts
from slam.simulation.config import SimulationConfig
from tests.helpers.graphs import with_edges
from tests.helpers.short_drives import drive, keep_until, map_in_memory, write_map


@pytest.fixture(scope="module")
def known() -> SavedMap:
    final = map_in_memory(keep_until(drive(SimulationConfig()), 12.0)).finish()
    return SavedMap(confirmed(final.object_map), final.graph)


def with_first(record: Any, name: str, value: Any) -> Any:
    """A copy of a record with another first entry in a field."""
    values = getattr(record, name)
    if isinstance(values, tuple):
        return replace(record, **{name: (value, *values[1:])})
    changed = values.copy()
    changed[0] = value
    return replace(record, **{name: changed})


OBJECT_FAULTS = {
    "landmark 1 is in it more than once": ("ids", "1"),
    "class tree is in it more than once": ("vocabulary", "tree"),
    "is not confirmed": ("states", "tentative"),
    "damaged": ("positions", np.nan),
    "has a matrix that is not a covariance": ("covariances", -np.eye(3)),
    "class probabilities": ("class_probabilities", 0.0),
    "was never seen": ("observation_counts", 0),
}
GRAPH_FAULTS = {
    "keyframe 1 is in it more than once": ("keyframe_ids", 1),
    "the number of keyframe -1 is negative": ("keyframe_ids", -1),
    "an edge of its graph ends at keyframe 4000": ("edge_keyframe_ids", [0, 4000]),
    "leads from keyframe 0 to itself": ("edge_keyframe_ids", [0, 0]),
    "observes from keyframe 4000": ("observation_keyframe_ids", 4000),
    "observes landmark 4000, which it does not have": ("observation_landmark_ids", "4000"),
    "of an unknown kind 'magic'": ("edge_kinds", "magic"),
    "edge 0 -> 1 of its graph has a covariance that is not positive definite": ("edge_covariances", np.zeros((6, 6))),
    "with a covariance that is not positive definite": ("observation_covariances", -np.eye(3)),
    "an observation without a positive covariance inflation": ("observation_redundancies", 0.0),
}
"""By what is told of it: a field, and its first entry that is wrong."""


def refusal(path: Path) -> str:
    with pytest.raises(SavedMapError) as refused:
        load_map(path)
    assert "\n" not in str(refused.value)
    assert str(refused.value).startswith(str(path))
    return str(refused.value)


@pytest.mark.parametrize("fault", OBJECT_FAULTS)
def test_landmarks_that_do_not_fit_together_are_refused(known: SavedMap, tmp_path: Path, fault: str) -> None:
    objects = with_first(known.objects, *OBJECT_FAULTS[fault])
    assert fault in refusal(write_map(tmp_path / "m.mcap", objects, known.graph))


@pytest.mark.parametrize("fault", GRAPH_FAULTS)
def test_a_graph_that_does_not_fit_together_is_refused(known: SavedMap, tmp_path: Path, fault: str) -> None:
    graph = replace(known.graph, observation_redundancies=np.ones(len(known.graph.observation_positions)))
    assert fault in refusal(write_map(tmp_path / "m.mcap", known.objects, with_first(graph, *GRAPH_FAULTS[fault])))


def test_a_graph_in_pieces_is_refused(known: SavedMap, tmp_path: Path) -> None:
    path = write_map(tmp_path / "m.mcap", known.objects, with_edges(known.graph, slice(0)))
    assert "no edge connects keyframe 1 to the first one" in refusal(path)


def test_two_maps_in_one_file_are_refused(known: SavedMap, tmp_path: Path) -> None:
    path = write_map(tmp_path / "m.mcap", known.objects, known.graph, twice=True)
    assert "holds 2 object maps and 1 graphs" in refusal(path)


def test_observations_of_keyframes_that_were_summed_up_may_have_less_than_one_as_redundancy(
    known: SavedMap, tmp_path: Path
) -> None:
    graph = replace(known.graph, observation_redundancies=np.full(len(known.graph.observation_positions), 0.5))
    assert load_map(write_map(tmp_path / "m.mcap", known.objects, graph)).objects.ids == known.objects.ids


@given(st.permutations(range(9)), st.lists(st.tuples(st.integers(0, 8), st.integers(0, 8)), max_size=20))
def test_parts_are_numbered_in_the_order_of_their_first_rows(ids, pairs):
    rows = np.array(pairs, int).reshape(-1, 2)
    reached = np.eye(9, dtype=np.bool_)
    reached[rows[:, 0], rows[:, 1]] = reached[rows[:, 1], rows[:, 0]] = True
    for _ in range(4):
        reached = reached @ reached
    np.testing.assert_array_equal(
        parts(np.array(ids), np.array(ids)[rows]), np.unique(reached.argmax(axis=1), return_inverse=True)[1]
    )
