"""What the network learns from: simulated maps are as the paper says, and so is the noise that observations get."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy import stats
from scipy.cluster.hierarchy import fcluster, linkage
from scipy.spatial.distance import cdist

from descriptors.constellation import gather_constellations
from descriptors.descriptellation.augmentation import (
    ADDED_NOISE,
    AugmentationRates,
    Normal,
    Uniform,
    add_false_positives,
    augment,
    compact,
    crop,
    drop_out,
    misclassify,
    orient,
    scale,
    translate,
)
from descriptors.descriptellation.dataset import DatasetConfig, make_dataset, simulate_anchors
from descriptors.descriptellation.simulation import MapSimulation, simulate_map
from descriptors.errors import DescriptorError
from descriptors.learned.padded import PaddedConstellations

CLASSES = 20
NOWHERE = Uniform(0.0, 0.0)
NOTHING = AugmentationRates(NOWHERE, NOWHERE, 0.0, 0.0, 0.0, NOWHERE, Uniform(1.0, 1.0), CLASSES)
Augmentation = Callable[[PaddedConstellations, np.random.Generator], PaddedConstellations]
AUGMENTATIONS: dict[str, Augmentation] = {
    "translate": lambda batch, rng: translate(batch, Normal(0.25), rng=rng),
    "orient": lambda batch, rng: orient(batch, Uniform(-np.pi, np.pi), rng=rng),
    "drop_out": lambda batch, rng: drop_out(batch, 0.5, rng=rng),
    "add_false_positives": lambda batch, rng: add_false_positives(batch, 0.5, CLASSES, rng=rng),
    "misclassify": lambda batch, rng: misclassify(batch, 1.0, CLASSES, rng=rng),
    "crop": lambda batch, rng: crop(batch, Uniform(0.5, 1.5), rng=rng),
    "scale": lambda batch, rng: scale(batch, Uniform(0.85, 1.25), rng=rng),
    "augment": lambda batch, rng: augment(batch, AugmentationRates(vocabulary_size=CLASSES), rng=rng),
    "added noise": lambda batch, rng: augment(batch, replace(ADDED_NOISE, vocabulary_size=CLASSES), rng=rng),
}
each_augmentation = pytest.mark.parametrize("augmentation", AUGMENTATIONS.values(), ids=AUGMENTATIONS.keys())


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
    """Seeds are fixed, so this fails either always or never."""
    assert stats.kstest(samples, distribution, args=args).pvalue > 1e-3


def assert_share(hits: int, trials: int, probability: float) -> None:
    """Within four deviations of the binomial distribution."""
    deviation = np.sqrt(trials * probability * (1.0 - probability))
    assert abs(hits - trials * probability) < 4.0 * deviation


# Maps.


def test_a_map_has_as_many_patterns_and_objects_in_each_as_drawn_uniformly():
    rng = np.random.default_rng(0)
    one_pattern = MapSimulation(patterns=(1, 1), objects_per_pattern=(3, 9))
    sizes = Counter(len(simulate_map(one_pattern, rng=rng).labels) for _ in range(2100))
    assert set(sizes) == set(range(3, 10))
    assert stats.chisquare(list(sizes.values())).pvalue > 1e-3
    lonely_patterns = MapSimulation(patterns=(2, 5), objects_per_pattern=(1, 1))
    sizes = Counter(len(simulate_map(lonely_patterns, rng=rng).labels) for _ in range(2000))
    assert set(sizes) == {2, 3, 4, 5}
    assert stats.chisquare(list(sizes.values())).pvalue > 1e-3


def test_patterns_lie_anywhere_in_the_square_and_objects_at_normal_heights():
    simulation = MapSimulation(patterns=(3000, 3000), objects_per_pattern=(1, 1), kinds=("line",), side_m=50.0)
    positions = simulate_map(simulation, rng=np.random.default_rng(1)).positions
    assert_is_drawn_from(positions[:, 0], "uniform", 0.0, 50.0)
    assert_is_drawn_from(positions[:, 1], "uniform", 0.0, 50.0)
    assert_is_drawn_from(positions[:, 2], "norm", 0.0, 1.5)


def separate_patterns(simulation: MapSimulation, *, seed: int) -> list[NDArray[np.float64]]:
    """The horizontal coordinates of each pattern of a map so wide that patterns do not meet."""
    wide = replace(simulation, side_m=1.0e6)
    plan = simulate_map(wide, rng=np.random.default_rng(seed)).positions[:, :2]
    patterns = fcluster(linkage(plan), 200.0, criterion="distance")
    return [plan[patterns == pattern] for pattern in np.unique(patterns)]


def test_lines_are_straight_with_even_steps_and_any_heading():
    lines = separate_patterns(
        MapSimulation(patterns=(200, 200), objects_per_pattern=(3, 9), kinds=("line",), line_step_m=(4.0, 12.0)), seed=2
    )
    assert len(lines) == 200
    steps = [np.diff(line, axis=0) for line in lines]
    assert all(np.allclose(step, step[0], atol=1e-6) for step in steps)
    assert_is_drawn_from(np.array([np.linalg.norm(step[0]) for step in steps]), "uniform", 4.0, 8.0)
    headings = np.array([np.arctan2(step[0, 1], step[0, 0]) for step in steps])
    assert_is_drawn_from(headings, "uniform", -np.pi, 2.0 * np.pi)


def test_circles_have_their_objects_at_one_distance_from_the_middle_all_around():
    circles = separate_patterns(
        MapSimulation(patterns=(200, 200), objects_per_pattern=(3, 9), kinds=("circle",), circle_radius_m=(4.0, 20.0)),
        seed=3,
    )
    assert len(circles) == 200
    radii_m = [np.linalg.norm(circle - circle.mean(axis=0), axis=1) for circle in circles]
    assert all(np.allclose(radius_m, radius_m[0], atol=1e-6) for radius_m in radii_m)
    assert_is_drawn_from(np.array([radius_m[0] for radius_m in radii_m]), "uniform", 4.0, 16.0)
    for circle, radius_m in zip(circles, radii_m, strict=True):
        side_m = 2.0 * radius_m[0] * np.sin(np.pi / len(circle))
        assert np.linalg.norm(circle - np.roll(circle, 1, axis=0), axis=1) == pytest.approx(side_m, abs=1e-6)


def test_clusters_are_normal():
    simulation = MapSimulation(
        patterns=(1, 1), objects_per_pattern=(4000, 4000), kinds=("cluster",), cluster_sigma_m=(2.0, 9.0)
    )
    plan = simulate_map(simulation, rng=np.random.default_rng(4)).positions[:, :2]
    away = plan - plan.mean(axis=0)
    variances, axes = np.linalg.eigh(np.cov(away.T))
    assert 2.0 < np.sqrt(variances[0]) < np.sqrt(variances[1]) < 9.0
    assert_is_drawn_from((away @ axes)[:, 0] / np.sqrt(variances[0]), "norm")
    assert_is_drawn_from((away @ axes)[:, 1] / np.sqrt(variances[1]), "norm")


def test_all_kinds_of_patterns_come_equally_often():
    patterns = separate_patterns(
        MapSimulation(patterns=(600, 600), objects_per_pattern=(5, 5), line_step_m=(4.0, 12.0)), seed=5
    )
    straight = sum(np.linalg.matrix_rank(pattern - pattern.mean(axis=0), tol=1e-6) == 1 for pattern in patterns)
    radii_m = [np.linalg.norm(pattern - pattern.mean(axis=0), axis=1) for pattern in patterns]
    round_ = sum(np.ptp(radius_m) < 1e-6 for radius_m in radii_m)
    assert len(patterns) == 600
    assert_share(straight, 600, 1 / 3)
    assert_share(round_, 600, 1 / 3)


def test_the_classes_of_each_map_are_drawn_anew_from_the_whole_vocabulary():
    simulation = MapSimulation(classes=(8, 30), objects_per_pattern=(60, 60))
    rng = np.random.default_rng(6)
    used = [np.unique(simulate_map(simulation, rng=rng).labels) for _ in range(1150)]
    counts = Counter(len(classes) for classes in used)
    assert set(counts) == set(range(8, 31))
    assert stats.chisquare(list(counts.values())).pvalue > 1e-3
    occurrences = np.bincount(np.concatenate(used), minlength=64)
    assert len(occurrences) == 64
    for occurrence in occurrences:
        assert_share(occurrence, len(used), 19 / 64)


def test_the_objects_of_a_map_have_its_classes_equally_often():
    simulation = MapSimulation(classes=(10, 10), patterns=(10, 10), objects_per_pattern=(500, 500))
    labels = simulate_map(simulation, rng=np.random.default_rng(7)).labels
    assert labels.dtype == np.int64
    assert stats.chisquare(np.unique(labels, return_counts=True)[1]).pvalue > 1e-3


def test_of_the_patterns_the_wanted_share_repeats_one_label():
    def share_of_one_label(share: float) -> int:
        simulation = MapSimulation(
            patterns=(1, 1), objects_per_pattern=(8, 8), classes=(20, 20), uniform_pattern_share=share
        )
        rng = np.random.default_rng(8)
        return sum(len(set(simulate_map(simulation, rng=rng).labels.tolist())) == 1 for _ in range(500))

    assert share_of_one_label(0.0) == 0
    assert share_of_one_label(1.0) == 500
    assert_share(share_of_one_label(0.4), 500, 0.4)


def test_constellations_of_the_default_maps_are_as_large_as_said():
    rng = np.random.default_rng(9)
    sizes: list[int] = []
    for _ in range(80):
        simulated = simulate_map(MapSimulation(), rng=rng)
        names = [str(number) for number in range(64)]
        around = gather_constellations(simulated.positions, simulated.labels, names, radius_m=30.0)
        sizes.extend(np.diff(around.offsets) + 1)
    assert np.median(sizes) == pytest.approx(18.0, abs=1.5)
    assert np.mean((np.array(sizes) >= 10) & (np.array(sizes) <= 30)) == pytest.approx(0.75, abs=0.06)


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"patterns": (5, 3)}, "patterns from 5 to 3"),
        ({"objects_per_pattern": (0, 3)}, "objects_per_pattern from 0 to 3"),
        ({"line_step_m": (-1.0, 3.0)}, "line_step_m from -1.0"),
        ({"classes": (8, 65)}, "65 classes of a vocabulary of 64"),
        ({"kinds": ("star",)}, "star"),
        ({"kinds": ()}, "at least one"),
    ],
)
def test_ranges_that_make_no_map_are_refused(changes, message):
    with pytest.raises(DescriptorError, match=message):
        MapSimulation(**changes)


# Augmentations.


@each_augmentation
def test_the_centre_stays_and_what_comes_back_is_a_batch_without_holes(augmentation):
    batch = batch_of(500, seed=10)
    before = (batch.positions.copy(), batch.labels.copy(), batch.present.copy())
    with np.errstate(all="raise"):
        noisy = augmentation(batch, np.random.default_rng(11))
    assert all(
        np.array_equal(a, b) for a, b in zip(before, (batch.positions, batch.labels, batch.present), strict=True)
    )
    assert noisy.present[:, 0].all()
    assert not noisy.positions[:, 0].any()
    assert np.array_equal(noisy.labels[:, 0], batch.labels[:, 0])
    assert (noisy.positions.dtype, noisy.labels.dtype, noisy.present.dtype) == (np.float32, np.int64, np.bool_)
    assert np.isfinite(noisy.positions).all()
    assert not noisy.positions[~noisy.present].any()
    assert not noisy.labels[~noisy.present].any()
    assert not (noisy.present[:, 1:] & ~noisy.present[:, :-1]).any()
    assert noisy.present[:, -1].any()
    assert noisy.labels.max() < CLASSES


@each_augmentation
def test_the_same_generator_gives_the_same_noise_and_no_constellation_gives_none(augmentation):
    batch = batch_of(50, seed=12)
    first, again, other = (augmentation(batch, np.random.default_rng(seed)) for seed in (1, 1, 2))
    assert first.positions.tobytes() == again.positions.tobytes()
    assert first.labels.tobytes() == again.labels.tobytes()
    assert (first.positions.tobytes(), first.labels.tobytes()) != (other.positions.tobytes(), other.labels.tobytes())
    assert len(augmentation(batch[np.zeros(0, dtype=np.int64)], np.random.default_rng(1))) == 0


def test_translations_grow_with_the_distance_and_are_independent_along_the_axes():
    batch = batch_of(1000, seed=13)
    others = batch.present & (lengths(batch) > 0.0)
    for distribution, named in ((Normal(0.25), ("norm", 0.0, 0.25)), (Uniform(0.0, 0.1), ("uniform", 0.0, 0.1))):
        moved = translate(batch, distribution, rng=np.random.default_rng(14))
        errors = (moved.positions - batch.positions)[others] / lengths(batch)[others][:, None]
        assert_is_drawn_from(errors.ravel(), *named)
        assert np.abs(np.corrcoef(errors.T) - np.eye(3)).max() < 4.0 / np.sqrt(len(errors))
        per_constellation = [np.mean(moved.positions[i][others[i]] / batch.positions[i][others[i]]) for i in (1, 2)]
        assert per_constellation[0] != pytest.approx(per_constellation[1])


def test_orientations_turn_a_constellation_as_a_whole_about_gravity():
    batch = batch_of(2000, seed=15)
    turned = orient(batch, Uniform(-np.pi, np.pi), rng=np.random.default_rng(16))
    assert np.array_equal(turned.positions[:, :, 2], batch.positions[:, :, 2])
    for row in range(50):
        here = batch.present[row]
        before, after = (b.positions[row][here].astype(np.float64) for b in (batch, turned))
        assert np.allclose(cdist(before, before), cdist(after, after), atol=1e-4)
    plane, turned_plane = (b.positions[:, :, 0] + 1j * b.positions[:, :, 1] for b in (batch, turned))
    yaws = np.angle(turned_plane[1:, 1] / plane[1:, 1])
    assert_is_drawn_from(yaws, "uniform", -np.pi, 2.0 * np.pi)
    assert np.allclose(plane[1:] * np.exp(1j * yaws)[:, None], turned_plane[1:], atol=1e-3)


def test_objects_drop_out_as_often_as_said_and_the_rest_keeps_its_order():
    batch = batch_of(2000, seed=17)
    thinned = drop_out(batch, 0.1, rng=np.random.default_rng(18))
    others = int(batch.present[:, 1:].sum())
    assert_share(others - int(thinned.present[:, 1:].sum()), others, 0.1)
    for row in range(200):
        before = objects(batch, row)
        kept = objects(thinned, row)
        assert kept == [one for one in before if one in kept]


def test_false_positives_come_as_often_as_said_anywhere_on_the_disc_and_of_any_class():
    batch = batch_of(3000, seed=19)
    filled = add_false_positives(batch, 0.1, CLASSES, rng=np.random.default_rng(20))
    sizes, all_ = batch.present.sum(axis=1), int(batch.present.sum())
    places = np.arange(filled.present.shape[1])
    added = filled.present & (places >= sizes[:, None])
    assert_share(int(added.sum()), all_, 0.1)
    for row in range(200):
        assert objects(filled, row)[: sizes[row]] == objects(batch, row)
    assert stats.chisquare(np.bincount(filled.labels[added], minlength=CLASSES)).pvalue > 1e-3
    rows = np.nonzero(added)[0]
    plan = filled.positions[added][:, :2].astype(np.float64)[rows > 0]
    radii_m = np.linalg.norm(batch.positions[:, :, :2].astype(np.float64), axis=2).max(axis=1)[rows[rows > 0]]
    assert_is_drawn_from((np.linalg.norm(plan, axis=1) / radii_m) ** 2, "uniform", 0.0, 1.0)
    assert_is_drawn_from(np.arctan2(plan[:, 1], plan[:, 0]), "uniform", -np.pi, 2.0 * np.pi)


def test_false_positives_are_as_high_as_the_objects_that_gave_rise_to_them():
    batch = batch_of(200, seed=37)
    twice = add_false_positives(batch, 1.0, CLASSES, rng=np.random.default_rng(38))
    for row in range(len(batch)):
        heights = batch.positions[row, batch.present[row], 2]
        assert np.array_equal(twice.positions[row, twice.present[row], 2], np.tile(heights, 2))


def test_far_objects_are_misclassified_more_often_and_then_as_any_other_class():
    batch = batch_of(6000, seed=21)
    confused = misclassify(batch, 0.4, CLASSES, rng=np.random.default_rng(22))
    assert np.array_equal(confused.positions, batch.positions)
    shares = lengths(batch)[1:] / lengths(batch)[1:].max(axis=1, keepdims=True)
    changed = (confused.labels != batch.labels)[1:]
    for low in np.arange(0.0, 1.0, 0.2):
        here = batch.present[1:] & (shares > low) & (shares <= low + 0.2)
        assert_share(int(changed[here].sum()), int(here.sum()), float(shares[here].mean()) * 0.4)
    farthest = batch.present[1:] & (shares == 1.0)
    assert_share(int(changed[farthest].sum()), int(farthest.sum()), 0.4)
    steps = ((confused.labels - batch.labels) % CLASSES)[1:][changed]
    assert stats.chisquare(np.bincount(steps, minlength=CLASSES)[1:]).pvalue > 1e-3


def test_with_alpha_one_the_farthest_object_is_always_misclassified():
    batch = batch_of(500, seed=23)[1:]
    confused = misclassify(batch, 1.0, CLASSES, rng=np.random.default_rng(24))
    farthest = lengths(batch).argmax(axis=1)[:, None]
    differs = np.take_along_axis(batch.labels, farthest, 1) != np.take_along_axis(confused.labels, farthest, 1)
    assert differs.all()


def cropped_by_hand(batch: PaddedConstellations, row: int, share: float, axis: int) -> list[tuple[float, ...]]:
    everything = objects(batch, row)
    limit_m = max(np.linalg.norm(one[:3]) for one in everything) * (1.0 - share)
    return [one for one in everything if not one[axis] > limit_m]


@pytest.mark.parametrize("share", [0.0, 0.3, 0.8])
def test_crops_remove_what_the_formula_names_along_x_or_y(share):
    batch = batch_of(600, seed=25)
    cropped = crop(batch, Uniform(share, share), rng=np.random.default_rng(26))
    along_x = along_y = 0
    for row in range(len(batch)):
        by_x, by_y = (cropped_by_hand(batch, row, share, axis) for axis in (0, 1))
        kept = objects(cropped, row)
        assert kept in (by_x, by_y)
        along_x += by_x != by_y and kept == by_x
        along_y += by_x != by_y and kept == by_y
    if share == 0.0:
        assert np.array_equal(cropped.positions, batch.positions)
    else:
        assert_share(along_x, along_x + along_y, 0.5)


def test_the_share_that_a_crop_removes_is_drawn_for_each_constellation():
    diagonal = np.linspace(0.0, 700.0, 701, dtype=np.float32)
    one = np.stack([diagonal, diagonal, np.zeros_like(diagonal)], axis=1)
    farthest_m = float(np.linalg.norm(one[-1]))
    batch = PaddedConstellations(
        np.tile(one, (400, 1, 1)), np.zeros((400, 701), dtype=np.int64), np.ones((400, 701), dtype=np.bool_)
    )
    cropped = crop(batch, Uniform(0.4, 0.9), rng=np.random.default_rng(27))
    shares = 1.0 - (cropped.present.sum(axis=1) - 0.5) / farthest_m
    assert_is_drawn_from(shares, "uniform", 0.4, 0.5)


def test_scales_stretch_a_constellation_by_one_factor():
    batch = batch_of(2000, seed=28)
    scaled = scale(batch, Uniform(0.85, 1.25), rng=np.random.default_rng(29))
    factors = lengths(scaled)[1:, 1] / lengths(batch)[1:, 1]
    assert_is_drawn_from(factors, "uniform", 0.85, 0.4)
    assert np.allclose(batch.positions[1:] * factors[:, None, None], scaled.positions[1:], atol=1e-4)


def test_compacting_keeps_all_objects_in_their_order():
    batch = batch_of(300, seed=30)
    present = batch.present & (np.random.default_rng(31).random(batch.present.shape) < 0.6)
    present[:, 0] = True
    sparse = PaddedConstellations(batch.positions, batch.labels, present)
    dense = compact(sparse)
    assert dense.present.shape[1] == present.sum(axis=1).max() < present.shape[1]
    assert all(objects(dense, row) == objects(sparse, row) for row in range(len(batch)))


def test_augmenting_at_rates_of_nothing_changes_nothing():
    batch = batch_of(100, seed=32)
    same = augment(batch, NOTHING, rng=np.random.default_rng(33))
    assert np.array_equal(same.positions, batch.positions)
    assert np.array_equal(same.labels, batch.labels)
    assert np.array_equal(same.present, batch.present)


def test_augmenting_applies_each_rate_and_adds_objects_after_some_dropped_out():
    batch = batch_of(300, seed=34)
    rng = np.random.default_rng(35)
    sizes = batch.present.sum(axis=1)
    emptied = augment(batch, replace(NOTHING, dropout=1.0, false_positives=1.0), rng=rng)
    assert (emptied.present.sum(axis=1) == 2).all()
    twice = augment(batch, replace(NOTHING, false_positives=1.0), rng=rng)
    assert np.array_equal(twice.present.sum(axis=1), 2 * sizes)
    assert np.allclose(
        augment(batch, replace(NOTHING, scale=Uniform(2.0, 2.0)), rng=rng).positions, 2 * batch.positions
    )
    upside = augment(batch, replace(NOTHING, yaw_rad=Uniform(np.pi, np.pi)), rng=rng)
    assert np.allclose(upside.positions[:, :, :2], -batch.positions[:, :, :2], atol=1e-5)
    assert (augment(batch, replace(NOTHING, misclassification=1.0), rng=rng).labels != batch.labels).any()
    assert (augment(batch, replace(NOTHING, translation=Normal(0.1)), rng=rng).positions != batch.positions).any()
    assert augment(batch, replace(NOTHING, crop=Uniform(1.0, 1.0)), rng=rng).present.sum() < 0.7 * batch.present.sum()


def test_the_added_noise_of_the_experiments_neither_turns_nor_crops_nor_adds():
    batch = batch_of(300, seed=39)
    rates = replace(ADDED_NOISE, translation=NOWHERE, dropout=0.0, vocabulary_size=CLASSES)
    noisy = augment(batch, rates, rng=np.random.default_rng(40))
    assert np.array_equal(noisy.present, batch.present)
    factors = lengths(noisy)[1:, 1] / lengths(batch)[1:, 1]
    assert_is_drawn_from(factors, "uniform", 0.9, 0.2)
    assert np.allclose(noisy.positions[1:], batch.positions[1:] * factors[:, None, None], atol=1e-4)


def test_rates_that_are_none_and_labels_beyond_the_vocabulary_are_refused():
    with pytest.raises(DescriptorError, match=r"dropout is 1\.5"):
        AugmentationRates(dropout=1.5)
    with pytest.raises(DescriptorError, match="at least 2"):
        AugmentationRates(vocabulary_size=1)
    batch = batch_of(50, seed=36)
    with pytest.raises(DescriptorError, match=f"labels up to {CLASSES - 1} and a vocabulary of 5"):
        augment(batch, AugmentationRates(vocabulary_size=5), rng=np.random.default_rng(0))


# Datasets.

SMALL = DatasetConfig(anchors=60, positives=4, anchors_per_map=7)


def test_a_dataset_has_each_anchor_with_its_positives():
    dataset = make_dataset(MapSimulation(), AugmentationRates(), SMALL, seed=1)
    assert np.array_equal(dataset.anchors, np.repeat(np.arange(60), 5))
    assert dataset.anchors.dtype == np.int64
    assert len(dataset.constellations) == 300
    assert np.isfinite(dataset.constellations.positions).all()
    assert dataset.constellations.present[:, 0].all()
    anchors = dataset.constellations[np.arange(0, 300, 5)]
    sizes = anchors.present.sum(axis=1)
    assert sizes.min() >= 5
    assert sizes.max() <= 40
    assert np.linalg.norm(anchors.positions[:, :, :2], axis=2).max() <= 30.0
    assert len({tuple(objects(anchors, row)) for row in range(60)}) == 60
    assert len({tuple(objects(dataset.constellations, row)) for row in range(300)}) == 300


def test_positives_show_the_place_of_their_anchor():
    still = replace(NOTHING, vocabulary_size=64)
    same = make_dataset(MapSimulation(), still, SMALL, seed=2).constellations
    assert all(objects(same, row) == objects(same, row - row % 5) for row in range(300))
    turning = replace(still, yaw_rad=Uniform(-np.pi, np.pi))
    turned = make_dataset(MapSimulation(), turning, SMALL, seed=2).constellations
    apart = lengths(turned).reshape(60, 5, -1)
    assert np.allclose(apart, apart[:, :1], atol=1e-4)
    assert not np.array_equal(turned.positions[1], turned.positions[0])


def test_the_same_seed_gives_the_same_bytes_and_another_one_another_dataset():
    first, again, other = (make_dataset(MapSimulation(), AugmentationRates(), SMALL, seed=seed) for seed in (3, 3, 4))
    for name in ("positions", "labels", "present"):
        assert getattr(first.constellations, name).tobytes() == getattr(again.constellations, name).tobytes()
        assert getattr(first.constellations, name).tobytes() != getattr(other.constellations, name).tobytes()


def test_an_anchor_is_all_that_lies_around_an_object_of_the_map():
    config = DatasetConfig(anchors=5, positives=0, anchors_per_map=5, radius_m=25.0)
    anchors = simulate_anchors(MapSimulation(), config, rng=np.random.default_rng(5))
    simulated = simulate_map(MapSimulation(), rng=np.random.default_rng(5))
    around_each = set()
    for centre in simulated.positions:
        away = simulated.positions - centre
        near = np.hypot(away[:, 0], away[:, 1]) <= 25.0
        kept = np.column_stack([away[near].astype(np.float32), simulated.labels[near]])
        around_each.add(frozenset(map(tuple, kept.tolist())))
    assert all(frozenset(objects(anchors, row)) in around_each for row in range(5))


def test_anchors_are_taken_from_a_series_of_maps():
    # A map of a single class tells by its label which map an anchor is from.
    one_class = MapSimulation(classes=(1, 1), vocabulary_size=2000)
    anchors = simulate_anchors(one_class, DatasetConfig(anchors=95, anchors_per_map=10), rng=np.random.default_rng(6))
    counts = Counter(anchors.labels[:, 0].tolist())
    assert sorted(counts.values()) == [5, *[10] * 9]


def test_sizes_that_make_no_dataset_are_refused():
    with pytest.raises(DescriptorError, match="0 anchors"):
        DatasetConfig(anchors=0)
    with pytest.raises(DescriptorError, match="raise max_objects"):
        DatasetConfig(max_objects=4)
    with pytest.raises(DescriptorError, match="64 classes and augmentations with 20"):
        make_dataset(MapSimulation(), AugmentationRates(vocabulary_size=20), SMALL, seed=0)
    empty = MapSimulation(patterns=(1, 1), objects_per_pattern=(1, 3))
    with pytest.raises(DescriptorError, match="without a constellation of 5 to 40 objects"):
        make_dataset(empty, AugmentationRates(), SMALL, seed=0)
