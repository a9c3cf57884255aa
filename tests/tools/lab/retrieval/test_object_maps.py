from __future__ import annotations

import numpy as np
import pytest

from descriptors.errors import DescriptorError
from logs.importers.maps.map_objects import MapObjects
from slam.common.errors import SimulationError
from tests.tools.lab.retrieval.test_map_tiles import forest, objects
from tools.lab.retrieval.object_maps import measure_recall


def town(count: int, extent_m: float) -> MapObjects:
    """Objects of six classes, the first as frequent as all others together."""
    labels = np.random.default_rng(1).choice(6, count, p=[0.5, 0.1, 0.1, 0.1, 0.1, 0.1])
    names = tuple(str(row) for row in range(count))
    return MapObjects("town", forest(count, extent_m), tuple(f"class {label}" for label in labels), names, False, "")


def test_a_descriptor_is_asked_in_each_map_and_finds_more_than_chance() -> None:
    figures = measure_recall(
        town(1500, 700.0),
        ["descriptellation_lr", "random"],
        sizes=[400, 1000],
        shares=[1.0, 0.5],
        classes=[4],
        queries=4,
    )
    assert [(each.descriptor, each.objects > 600) for each in figures[:4]] == [
        ("descriptellation_lr", False),
        ("random", False),
        ("descriptellation_lr", True),
        ("random", True),
    ]
    assert {each.classes for each in figures} == {4}
    full, thinned = figures[2], figures[6]
    assert full.objects == 1000
    assert 0.4 < thinned.neighbours / full.neighbours < 0.6
    for ours, chance in zip(figures[::2], figures[1::2], strict=True):
        assert ours.places[1] > chance.places[1]
        assert ours.places[1] <= ours.places[5] <= ours.places[25]
    assert figures[0].places[1] == 1.0


def test_rare_classes_become_one() -> None:
    (figures,) = measure_recall(town(600, 400.0), ["random"], sizes=[10_000], classes=[1], queries=1)
    assert (figures.objects, figures.classes) == (600, 1)


def test_the_same_paths_are_asked_whatever_the_classes() -> None:
    one = town(600, 400.0)
    asked = [
        measure_recall(one, ["descriptellation_lr"], sizes=[600], classes=count, queries=3) for count in ([6], [1, 6])
    ]
    alone, after_another = asked[0][0], asked[1][1]
    assert (alone.classes, alone.places, alone.neighbours) == (6, after_another.places, after_another.neighbours)


def test_degrees_and_unknown_descriptors_are_refused() -> None:
    with pytest.raises(SimulationError, match="metres"):
        measure_recall(objects(forest(50, 1.0), is_geodetic=True), ["random"], sizes=[10], queries=1)
    with pytest.raises(DescriptorError, match="rings"):
        measure_recall(town(50, 100.0), ["rings"], sizes=[10], queries=1)
