"""What networks learn from: simulated maps and views of them."""

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy import stats

from descriptors.training.maps import TrainingMap, draw_map, draw_pattern, draw_patterns, piece_of, with_classes_of
from descriptors.training.views import CLUTTER, draw_view


def assert_is_uniform(samples: NDArray[np.float64], *args: float) -> None:
    assert stats.kstest(samples, "uniform", args=args).pvalue > 1e-3


def patterns(kind: str, *, seed: int) -> list[NDArray[np.float64]]:
    """The horizontal coordinates of many patterns of 3 to 9 objects."""
    rng = np.random.default_rng(seed)
    plans = (draw_pattern(kind, int(rng.integers(3, 10)), rng=rng) for _ in range(200))
    return [np.column_stack([plan.real, plan.imag]) for plan in plans]


def test_lines_are_straight_with_even_steps():
    steps = [np.diff(line, axis=0) for line in patterns("line", seed=2)]
    assert all(np.allclose(step, step[0]) for step in steps)
    assert_is_uniform(np.array([np.linalg.norm(step[0]) for step in steps]), 4.0, 8.0)


def test_circles_have_their_objects_at_one_distance_from_the_middle():
    radii_m = [np.linalg.norm(each, axis=1) for each in patterns("circle", seed=3)]
    assert all(np.allclose(radius_m, radius_m[0]) for radius_m in radii_m)
    assert_is_uniform(np.array([radius_m[0] for radius_m in radii_m]), 4.0, 16.0)


@pytest.mark.parametrize("seed", range(4))
def test_a_map_of_patterns_has_so_many_objects_and_classes(seed):
    drawn = draw_patterns(rng=np.random.default_rng(seed))
    assert 40 * 3 <= len(drawn) <= 80 * 9
    assert len(np.unique(drawn.labels)) == drawn.classes <= 30


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


def test_classes_are_dealt_out_among_the_rows_of_an_embedding():
    given = TrainingMap(np.zeros((50, 3)), np.arange(50) % 10, 10)
    dealt = with_classes_of(given, 64, rng=np.random.default_rng(0))
    assert dealt.classes == 64
    assert len(np.unique(dealt.labels)) == 10
    np.testing.assert_array_equal(dealt.labels[:10], dealt.labels[10:20])
    assert not np.array_equal(dealt.labels, given.labels)
    assert with_classes_of(given, 4, rng=np.random.default_rng(0)).labels.max() < 4
