"""What networks learn from: simulated maps are as the paper says, and so is the noise of observations."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy import stats
from scipy.cluster.hierarchy import fcluster, linkage

from descriptors.learned.padded import PaddedConstellations
from descriptors.training.augmentation import (
    AugmentationRates,
    add_false_positives,
    augment,
    crop,
    drop_out,
    misclassify,
    orient,
    scale,
    translate,
)
from descriptors.training.dataset import DatasetConfig, make_dataset, simulate_anchors
from descriptors.training.maps import TrainingMap, draw_map, draw_street, piece_of
from descriptors.training.simulation import MapSimulation, simulate_map
from descriptors.training.views import CLUTTER, draw_view

CLASSES = 20
Augmentation = Callable[[PaddedConstellations, np.random.Generator], PaddedConstellations]
AUGMENTATIONS: dict[str, Augmentation] = {
    "translate": lambda batch, rng: translate(batch, 0.25, rng=rng),
    "orient": lambda batch, rng: orient(batch, (-np.pi, np.pi), rng=rng),
    "drop_out": lambda batch, rng: drop_out(batch, 0.5, rng=rng),
    "add_false_positives": lambda batch, rng: add_false_positives(batch, 0.5, CLASSES, rng=rng),
    "misclassify": lambda batch, rng: misclassify(batch, 1.0, CLASSES, rng=rng),
    "crop": lambda batch, rng: crop(batch, (0.5, 1.5), rng=rng),
    "scale": lambda batch, rng: scale(batch, (0.85, 1.25), rng=rng),
    "augment": lambda batch, rng: augment(batch, AugmentationRates(vocabulary_size=CLASSES), rng=rng),
}


def batch_of(count: int, *, seed: int, room: int = 24) -> PaddedConstellations:
    """Constellations of 1 to ``room`` objects, the first being a centre on its own."""
    rng = np.random.default_rng(seed)
    sizes = np.concatenate([[1], rng.integers(2, room, size=count - 1, endpoint=True)])
    present = np.arange(room) < sizes[:, None]
    positions = rng.normal(scale=(10.0, 10.0, 1.5), size=(count, room, 3)) * present[:, :, None]
    positions[:, 0] = 0.0
    return PaddedConstellations(
        positions.astype(np.float32), rng.integers(CLASSES, size=present.shape) * present, present
    )


def lengths(batch: PaddedConstellations) -> NDArray[np.float64]:
    return np.linalg.norm(batch.positions.astype(np.float64), axis=2)


def objects(batch: PaddedConstellations, row: int) -> list[tuple[float, ...]]:
    here = batch.present[row]
    return [(*p, c) for p, c in zip(batch.positions[row][here].tolist(), batch.labels[row][here].tolist(), strict=True)]


def assert_is_drawn_from(samples: NDArray[np.float64], distribution: str, *args: float) -> None:
    assert stats.kstest(samples, distribution, args=args).pvalue > 1e-3


def assert_equally_often(samples: NDArray[np.int64] | list[int], values: range) -> None:
    counts = Counter(np.asarray(samples).tolist())
    assert set(counts) == set(values)
    assert stats.chisquare(list(counts.values())).pvalue > 1e-3


def assert_share(hits: int, trials: int, probability: float) -> None:
    """Within four deviations of the binomial distribution."""
    assert abs(hits - trials * probability) < 4.0 * np.sqrt(trials * probability * (1.0 - probability))


# Maps.


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


# Augmentations.


@pytest.mark.parametrize("augmentation", AUGMENTATIONS.values(), ids=AUGMENTATIONS.keys())
def test_augmentation_keeps_the_centre_and_its_input_and_leaves_no_holes(augmentation):
    batch, before = batch_of(300, seed=10), batch_of(300, seed=10)
    noisy, again = (augmentation(batch, np.random.default_rng(11)) for _ in range(2))
    for name in ("positions", "labels", "present"):
        np.testing.assert_array_equal(getattr(batch, name), getattr(before, name))
        np.testing.assert_array_equal(getattr(noisy, name), getattr(again, name))
        assert getattr(noisy, name).dtype == getattr(batch, name).dtype
    assert noisy.present[:, 0].all()
    assert not noisy.positions[:, 0].any()
    np.testing.assert_array_equal(noisy.labels[:, 0], batch.labels[:, 0])
    assert np.isfinite(noisy.positions).all()
    assert not noisy.positions[~noisy.present].any()
    assert not noisy.labels[~noisy.present].any()
    assert not (noisy.present[:, 1:] & ~noisy.present[:, :-1]).any()
    assert noisy.labels.max() < CLASSES
    assert len(augmentation(batch[np.zeros(0, dtype=np.int64)], np.random.default_rng(1))) == 0


def test_translations_grow_with_the_distance_and_are_independent_along_the_axes():
    batch = batch_of(1000, seed=13)
    others = batch.present & (lengths(batch) > 0.0)
    moved = translate(batch, 0.25, rng=np.random.default_rng(14))
    errors = (moved.positions - batch.positions)[others] / lengths(batch)[others][:, None]
    assert_is_drawn_from(errors.ravel(), "norm", 0.0, 0.25)
    assert np.abs(np.corrcoef(errors.T) - np.eye(3)).max() < 4.0 / np.sqrt(len(errors))


def test_orientations_turn_a_constellation_as_a_whole_about_gravity():
    batch = batch_of(2000, seed=15)
    turned = orient(batch, (-np.pi, np.pi), rng=np.random.default_rng(16))
    np.testing.assert_array_equal(turned.positions[:, :, 2], batch.positions[:, :, 2])
    plane, turned_plane = (b.positions[:, :, 0] + 1j * b.positions[:, :, 1] for b in (batch, turned))
    yaws = np.angle(turned_plane[1:, 1] / plane[1:, 1])
    assert_is_drawn_from(yaws, "uniform", -np.pi, 2.0 * np.pi)
    assert np.allclose(plane[1:] * np.exp(1j * yaws)[:, None], turned_plane[1:], atol=1e-3)


def test_dropout_removes_the_given_share_and_keeps_the_order():
    batch = batch_of(2000, seed=17)
    thinned = drop_out(batch, 0.1, rng=np.random.default_rng(18))
    others = int(batch.present[:, 1:].sum())
    assert_share(others - int(thinned.present[:, 1:].sum()), others, 0.1)
    for row in range(100):
        kept = objects(thinned, row)
        assert kept == [one for one in objects(batch, row) if one in kept]


def test_false_positives_lie_on_the_disc_at_the_height_of_an_object_and_have_any_class():
    batch = batch_of(3000, seed=19)
    filled = add_false_positives(batch, 0.1, CLASSES, rng=np.random.default_rng(20))
    sizes = batch.present.sum(axis=1)
    added = filled.present & (np.arange(filled.present.shape[1]) >= sizes[:, None])
    assert_share(int(added.sum()), int(batch.present.sum()), 0.1)
    assert_equally_often(filled.labels[added], range(CLASSES))
    rows = np.nonzero(added)[0]
    plan = filled.positions[added][:, :2].astype(np.float64)[rows > 0]
    radii_m = np.linalg.norm(batch.positions[:, :, :2].astype(np.float64), axis=2).max(axis=1)[rows[rows > 0]]
    assert_is_drawn_from((np.linalg.norm(plan, axis=1) / radii_m) ** 2, "uniform", 0.0, 1.0)
    twice = add_false_positives(batch, 1.0, CLASSES, rng=np.random.default_rng(38))
    for row in range(100):
        heights = batch.positions[row, batch.present[row], 2]
        np.testing.assert_array_equal(twice.positions[row, twice.present[row], 2], np.tile(heights, 2))


def test_far_objects_are_misclassified_more_often_and_then_as_any_other_class():
    batch = batch_of(6000, seed=21)
    confused = misclassify(batch, 0.4, CLASSES, rng=np.random.default_rng(22))
    shares = lengths(batch)[1:] / lengths(batch)[1:].max(axis=1, keepdims=True)
    changed = (confused.labels != batch.labels)[1:]
    for low in np.arange(0.0, 1.0, 0.2):
        here = batch.present[1:] & (shares > low) & (shares <= low + 0.2)
        assert_share(int(changed[here].sum()), int(here.sum()), float(shares[here].mean()) * 0.4)
    assert_equally_often(((confused.labels - batch.labels) % CLASSES)[1:][changed], range(1, CLASSES))


@pytest.mark.parametrize("share", [0.0, 0.3, 0.8])
def test_crops_remove_what_the_formula_names_along_x_or_y(share):
    batch = batch_of(600, seed=25)
    cropped = crop(batch, (share, share), rng=np.random.default_rng(26))
    along = Counter[int]()
    for row in range(len(batch)):
        everything, kept = objects(batch, row), objects(cropped, row)
        limit_m = max(np.linalg.norm(one[:3]) for one in everything) * (1.0 - share)
        by_axis = [[one for one in everything if not one[axis] > limit_m] for axis in (0, 1)]
        assert kept in by_axis
        if by_axis[0] != by_axis[1]:
            along[by_axis.index(kept)] += 1
    if share:
        assert_share(along[0], along.total(), 0.5)


# Datasets.

SMALL = DatasetConfig(anchors=60, positives=4, anchors_per_map=7)


def test_dataset_has_each_anchor_with_its_positives():
    dataset, again = (make_dataset(MapSimulation(), AugmentationRates(), SMALL, seed=1) for _ in range(2))
    np.testing.assert_array_equal(dataset.anchors, np.repeat(np.arange(60), 5))
    np.testing.assert_array_equal(dataset.constellations.positions, again.constellations.positions)
    anchors = dataset.constellations[np.arange(0, 300, 5)]
    sizes = anchors.present.sum(axis=1)
    assert 5 <= sizes.min() <= sizes.max() <= 40
    assert np.linalg.norm(anchors.positions[:, :, :2], axis=2).max() <= 30.0
    assert len({tuple(objects(dataset.constellations, row)) for row in range(300)}) == 300


def test_anchors_are_constellations_of_a_series_of_maps():
    # A map of a single class tells by its label which map an anchor is from.
    one_class = MapSimulation(classes=(1, 1), vocabulary_size=2000)
    anchors = simulate_anchors(one_class, DatasetConfig(anchors=95, anchors_per_map=10), rng=np.random.default_rng(6))
    assert sorted(Counter(anchors.labels[:, 0].tolist()).values()) == [5, *[10] * 9]
    drawn = simulate_map(one_class, rng=np.random.default_rng(6))
    around = set()
    for centre in drawn.positions:
        away = drawn.positions - centre
        near = np.hypot(away[:, 0], away[:, 1]) <= 30.0
        around.add(frozenset(map(tuple, away[near].astype(np.float32).tolist())))
    assert all(frozenset(each[:3] for each in objects(anchors, row)) in around for row in range(10))
