"""The paper's index: its graphs by the mean distance of the map, its candidates of any class."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.distance import cdist

from descriptors.constellation import gather_constellations
from descriptors.descriptellation.index import MAX_OBJECTS, PaperIndex, mean_distance_m
from descriptors.registry import make_index
from tests.descriptors.constellations import VOCABULARY, scattered

pytestmark = pytest.mark.slow


def test_the_mean_distance_is_that_of_all_pairs():
    positions, _ = scattered(60, seed=0)
    apart_m = cdist(positions, positions)
    assert mean_distance_m(positions) == pytest.approx(apart_m.sum() / (60 * 59))
    assert mean_distance_m(positions[:1]) == mean_distance_m(positions[:0]) == 0.0


def test_a_part_tells_the_mean_distance_of_a_large_map():
    positions, _ = scattered(2 * MAX_OBJECTS, seed=0, side_m=600.0)
    assert mean_distance_m(positions) == pytest.approx(0.521 * 600.0, rel=0.02)  # of a square, by its side


def test_the_graphs_follow_the_map_that_the_objects_are_of():
    """The same objects in a hall and in a map that goes on elsewhere: other edges, so other vectors."""
    positions, labels = scattered(12, seed=1, side_m=10.0)
    far = np.vstack([positions, positions + np.array([500.0, 0.0, 0.0])])

    def distances(where):
        index = make_index("descriptellation")
        assert isinstance(index, PaperIndex)
        both = np.tile(labels, len(where) // len(labels))
        entries = gather_constellations(where, both, VOCABULARY, radius_m=index.radius_m)
        index.add(entries)
        few = entries[np.arange(12)]
        return index.search(few, len(where), np.ones(len(where), dtype=np.bool_)).distances

    hall, wide = distances(positions), distances(far)
    assert hall.min() == wide.min() == pytest.approx(0.0, abs=1e-2)  # each is its own nearest
    assert abs(hall.max() - wide.max()) > 1e-2


def test_candidates_are_of_any_class():
    positions, labels = scattered(30, seed=2)
    index = make_index("descriptellation")
    entries = gather_constellations(positions, labels, VOCABULARY, radius_m=index.radius_m)
    index.add(entries)
    matches = index.search(entries, 30, np.ones(30, dtype=np.bool_))
    assert len(matches.queries) == 900
    assert (labels[matches.queries] != labels[matches.entries]).any()
