"""What networks learn from: simulated maps and views of them."""

from __future__ import annotations

from collections import Counter

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy import stats
from scipy.cluster.hierarchy import fcluster, linkage

from descriptors.training.maps import TrainingMap, draw_map, draw_street, piece_of, with_classes_of
from descriptors.training.simulation import MapSimulation, simulate_map
from descriptors.training.views import CLUTTER, draw_view


def assert_is_drawn_from(samples: NDArray[np.float64], distribution: str, *args: float) -> None:
    assert stats.kstest(samples, distribution, args=args).pvalue > 1e-3


def assert_equally_often(samples: NDArray[np.int64] | list[int], values: range) -> None:
    counts = Counter(np.asarray(samples).tolist())
    assert set(counts) == set(values)
    assert stats.chisquare(list(counts.values())).pvalue > 1e-3


def test_map_has_numbers_of_patterns_objects_and_classes_drawn_uniformly():
    rng = np.random.default_rng(0)
    one_pattern, lonely_patterns, many_objects = (
        MapSimulation(patterns=(1, 1), objects_per_pattern=(3, 9)),
        MapSimulation(patterns=(2, 5), objects_per_pattern=(1, 1)),
        MapSimulation(classes=(8, 12), objects_per_pattern=(60, 60)),
    )
    assert_equally_often([len(simulate_map(one_pattern, rng=rng).labels) for _ in range(1500)], range(3, 10))
    assert_equally_often([len(simulate_map(lonely_patterns, rng=rng).labels) for _ in range(1500)], range(2, 6))
    used = [np.unique(simulate_map(many_objects, rng=rng).labels) for _ in range(600)]
    assert_equally_often([len(classes) for classes in used], range(8, 13))
    assert_equally_often(np.concatenate(used), range(64))


def separate_patterns(kind: str, *, seed: int) -> list[NDArray[np.float64]]:
    """The horizontal coordinates of each pattern of a map so wide that patterns do not meet."""
    simulation = MapSimulation(patterns=(200, 200), objects_per_pattern=(3, 9), kinds=(kind,), side_m=1e6)
    plan = simulate_map(simulation, rng=np.random.default_rng(seed)).positions[:, :2]
    patterns = fcluster(linkage(plan), 200.0, criterion="distance")
    return [plan[patterns == pattern] for pattern in np.unique(patterns)]


def test_lines_are_straight_with_even_steps_and_any_heading():
    lines = separate_patterns("line", seed=2)
    steps = [np.diff(line, axis=0) for line in lines]
    assert all(np.allclose(step, step[0], atol=1e-6) for step in steps)
    first = np.array([step[0] for step in steps])
    assert_is_drawn_from(np.hypot(*first.T), "uniform", 4.0, 8.0)
    assert_is_drawn_from(np.arctan2(first[:, 1], first[:, 0]), "uniform", -np.pi, 2.0 * np.pi)


def test_circles_have_their_objects_at_one_distance_from_the_middle():
    radii_m = [np.linalg.norm(each - each.mean(axis=0), axis=1) for each in separate_patterns("circle", seed=3)]
    assert all(np.allclose(radius_m, radius_m[0], atol=1e-6) for radius_m in radii_m)
    assert_is_drawn_from(np.array([radius_m[0] for radius_m in radii_m]), "uniform", 4.0, 16.0)


@pytest.mark.parametrize("seed", range(6))
def test_drawn_maps_and_views_are_complete(seed):
    rng = np.random.default_rng(seed)
    given = TrainingMap(rng.normal(0.0, 100.0, (900, 3)), rng.integers(40, size=900), 40)
    for drawn in (draw_map([given], 0.5, rng=rng), draw_map([], 0.5, rng=rng), piece_of(given, rng=rng)):
        assert np.isfinite(drawn.positions).all()
        assert drawn.labels.max() < drawn.classes
        view = draw_view(drawn, rng=rng)
        real = view.objects[view.objects != CLUTTER]
        assert len(np.unique(real)) == len(real)
        assert view.labels.max(initial=0) < drawn.classes


def test_exact_view_has_objects_where_they_are():
    drawn = draw_street(rng=np.random.default_rng(3))
    for seed in range(5):
        view = draw_view(drawn, rng=np.random.default_rng(seed), is_exact=True)
        real = view.objects != CLUTTER
        np.testing.assert_array_equal(view.positions[real], drawn.positions[view.objects[real]])
        np.testing.assert_array_equal(view.labels[real], drawn.labels[view.objects[real]])


def test_classes_are_dealt_out_among_the_rows_of_an_embedding():
    given = TrainingMap(np.zeros((50, 3)), np.arange(50) % 10, 10)
    dealt = with_classes_of(given, 64, rng=np.random.default_rng(0))
    assert dealt.classes == 64
    assert len(np.unique(dealt.labels)) == 10
    np.testing.assert_array_equal(dealt.labels[:10], dealt.labels[10:20])
    assert not np.array_equal(dealt.labels, given.labels)
    assert with_classes_of(given, 4, rng=np.random.default_rng(0)).labels.max() < 4
