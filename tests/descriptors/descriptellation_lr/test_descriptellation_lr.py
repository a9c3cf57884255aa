"""The learned likelihood: numpy and torch agree, a sensor may turn, and training finds what was seen."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch
from safetensors import safe_open
from safetensors.numpy import save_file

from descriptors.constellation import Constellations, gather_constellations
from descriptors.descriptellation_lr import training
from descriptors.descriptellation_lr.learned_likelihood import LearnedLikelihood
from descriptors.descriptellation_lr.network import Towers, background_of
from descriptors.descriptellation_lr.rings import Background, Rings, horizontal_m
from descriptors.descriptellation_lr.training import TowersEpoch, TowersTraining, best_epoch, train_towers
from descriptors.descriptellation_lr.training_maps import TrainingMap, draw_forest, draw_map, draw_street, piece_of
from descriptors.descriptellation_lr.views import CLUTTER, draw_view
from descriptors.errors import DescriptorError, WeightsError
from descriptors.learned.training_folder import CHECKPOINT, WEIGHTS
from descriptors.likelihood_index import LikelihoodIndex
from descriptors.registry import make_index

TINY = TowersTraining(epochs=2, validation_maps=2, objects_per_map=30, views=1)


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A training of four steps, which nobody interrupted."""
    folder = tmp_path_factory.mktemp("towers")
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(training, "STEPS_PER_EPOCH", 2)
        train_towers(TINY, folder)
    return folder


def street(seed: int, radius_m: float = 60.0) -> tuple[TrainingMap, Constellations]:
    drawn = draw_street(rng=np.random.default_rng(seed))
    vocabulary = tuple(map(str, range(drawn.classes)))
    return drawn, gather_constellations(drawn.positions, drawn.labels, vocabulary, radius_m=radius_m)


def test_numpy_makes_of_the_weights_what_torch_makes(folder: Path) -> None:
    _, constellations = street(1)
    learned = LearnedLikelihood(folder / WEIGHTS)
    towers = Towers()
    from safetensors.torch import load_file

    towers.load_state_dict(load_file(folder / WEIGHTS))
    with torch.no_grad():
        expected = towers(constellations, background_of(constellations, towers.rings)).flatten(1).numpy()
    np.testing.assert_allclose(learned.describe(constellations), expected, atol=2e-3)


def test_what_turns_with_the_sensor_changes_nothing(folder: Path) -> None:
    drawn, constellations = street(2)
    turn = np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
    turned = gather_constellations(
        drawn.positions @ turn.T + 50.0, drawn.labels, constellations.vocabulary, radius_m=60.0
    )
    first, second = LearnedLikelihood(folder / WEIGHTS), LearnedLikelihood(folder / WEIGHTS)
    np.testing.assert_allclose(first.describe(constellations), second.describe(turned), atol=1e-3)


def test_a_map_may_grow_with_its_vocabulary(folder: Path) -> None:
    index = LikelihoodIndex(LearnedLikelihood(folder / WEIGHTS))
    rng = np.random.default_rng(0)
    positions, labels = rng.uniform(0.0, 80.0, (60, 3)), rng.integers(2, size=60)
    index.add(gather_constellations(positions, labels, ("a", "b"), radius_m=60.0))
    more = gather_constellations(positions + np.array([500.0, 0.0, 0.0]), labels + 1, ("a", "b", "c"), radius_m=60.0)
    index.add(more)
    matches = index.search(more, 1, np.ones(120, dtype=np.bool_))
    assert np.mean(matches.entries == 60 + np.arange(60)) > 0.9
    assert (matches.distances >= 0.0).all()
    assert len(LikelihoodIndex(LearnedLikelihood(folder / WEIGHTS))) == 0


def test_among_many_of_one_class_the_right_one_is_found() -> None:
    """In a forest all rings hold stems; that a place has more of them than another must not decide."""
    found = {}
    for name in ("descriptellation_lr", "ring_likelihood"):
        hits = []
        for seed in range(3):
            rng = np.random.default_rng(seed)
            forest = draw_forest(rng=rng)
            index = make_index(name)
            vocabulary = tuple(map(str, range(forest.classes)))
            index.add(gather_constellations(forest.positions, forest.labels, vocabulary, radius_m=index.radius_m))
            middle = forest.positions[rng.integers(len(forest)), :2]
            near = np.flatnonzero(np.hypot(*(forest.positions[:, :2] - middle).T) < 30.0)
            near = near[rng.random(len(near)) < 0.7]
            noisy = forest.positions[near] + rng.normal(0.0, 0.1, (len(near), 3))
            asking = gather_constellations(noisy, forest.labels[near], vocabulary, radius_m=index.radius_m)
            matches = index.search(asking, 5, np.ones(len(index), dtype=np.bool_))
            right = near[matches.queries] == matches.entries
            hits.append(np.count_nonzero(right) / max(len(near), 1))
        found[name] = float(np.mean(hits))
    assert found["descriptellation_lr"] > max(0.5, found["ring_likelihood"])


def test_rings_cover_all_distances_without_gaps() -> None:
    rings = Rings(60.0, 0.25, 0.02)
    assert rings.edges_m[0] == 0.0
    assert rings.edges_m[-1] == 60.0
    assert (np.diff(rings.widths_m) >= -1e-9).all()
    assert rings.of(np.array([0.0, 0.2, 59.99, 60.0, 1e3])).tolist() == [0, 0, *[len(rings) - 1] * 3]


def test_the_background_is_what_an_average_object_has_around_it() -> None:
    rng = np.random.default_rng(0)
    positions = np.column_stack([rng.uniform(-200.0, 200.0, (1600, 2)), np.zeros(1600)])  # 0.01 a square metre
    inner = np.flatnonzero(np.abs(positions[:, :2]).max(axis=1) < 140.0)
    constellations = gather_constellations(positions, np.zeros(1600, np.int64), ("tree",), radius_m=60.0, centres=inner)
    rings = Rings(60.0, 0.25, 0.02)
    background = Background(rings)
    background.add(constellations)
    expected = 2.0 * np.pi * rings.middles_m * 0.01
    np.testing.assert_allclose(background.density(1)[0, 10:-10], expected[10:-10], rtol=0.15)


@pytest.mark.parametrize("seed", range(6))
def test_maps_and_views_are_whole(seed: int) -> None:
    rng = np.random.default_rng(seed)
    given = TrainingMap(rng.normal(0.0, 100.0, (900, 3)), rng.integers(40, size=900), 40)
    for drawn in (draw_map([given], 0.5, rng=rng), draw_map([], 0.5, rng=rng), piece_of(given, rng=rng)):
        assert np.isfinite(drawn.positions).all()
        assert drawn.labels.max() < drawn.classes
        view = draw_view(drawn, rng=rng)
        real = view.objects[view.objects != CLUTTER]
        assert len(np.unique(real)) == len(real)
        assert view.labels.max(initial=0) < drawn.classes
        assert horizontal_m(view.positions).shape == view.labels.shape


def test_equal_trainings_give_equal_weights_interrupted_or_not(
    folder: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(training, "STEPS_PER_EPOCH", 2)
    steps: list[float] = []

    def interrupt(step: training.Step) -> None:
        steps.append(step.done)
        if len(steps) == 3:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        train_towers(TINY, tmp_path, on_step=interrupt)
    assert steps == [0.25, 0.5, 0.75]
    train_towers(TINY, tmp_path)
    assert (folder / WEIGHTS).read_bytes() == (tmp_path / WEIGHTS).read_bytes()
    with pytest.raises(DescriptorError, match="another configuration"):
        train_towers(replace(TINY, seed=1), tmp_path)
    with pytest.raises(DescriptorError, match=r"another configuration \(maps\)"):
        train_towers(TINY, tmp_path, [TrainingMap(np.zeros((5, 3)), np.zeros(5, np.int64), 1)])
    (tmp_path / CHECKPOINT).write_bytes(b"half a checkpoint")
    with pytest.raises(DescriptorError, match="cannot be read"):
        train_towers(TINY, tmp_path)


def test_weights_that_are_trained_further_compete_with_what_they_came_from(
    folder: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(training, "STEPS_PER_EPOCH", 2)
    rng = np.random.default_rng(1)
    given = [TrainingMap(rng.normal(0.0, 60.0, (200, 3)), rng.integers(4, size=200), 4)]
    start = folder / WEIGHTS
    small_steps = replace(TINY, learning_rate=1e-4, last_rate=1e-5)
    epochs = train_towers(small_steps, tmp_path / "further", given, start=start)
    assert [each.epoch for each in epochs] == [0, 1, 2]
    assert epochs[0].train_loss is None
    assert train_towers(small_steps, tmp_path / "further", given, start=start) == epochs  # complete: nothing is done
    # Steps that destroy what was learned: the weights are kept as they were.
    ruined = train_towers(replace(TINY, learning_rate=50.0, last_rate=50.0), tmp_path / "ruined", given, start=start)
    assert best_epoch(ruined).epoch == 0
    kept, before = (LearnedLikelihood(path)._weights for path in (tmp_path / "ruined" / WEIGHTS, start))
    assert all(np.array_equal(kept[name], before[name]) for name in before)
    with pytest.raises(DescriptorError, match=r"another configuration \(start\)"):
        train_towers(small_steps, tmp_path / "further", given, start=tmp_path / "ruined" / WEIGHTS)


def epoch(number: int, top_5: float, exact_top_5: float) -> TowersEpoch:
    return TowersEpoch(number, 1.0, 1.0, 0.5, top_5, 0.9, exact_top_5, 1.0)


def test_what_costs_objects_in_exact_views_is_not_taken() -> None:
    further = [epoch(0, 0.6, 0.90), epoch(1, 0.8, 0.89), epoch(2, 0.7, 0.90), epoch(3, 0.7, 0.95)]
    assert best_epoch(further).epoch == 2
    anew = [epoch(1, 0.6, 0.9), epoch(2, 0.8, 0.8)]
    assert best_epoch(anew).epoch == 2


def test_an_exact_view_shows_objects_where_they_are() -> None:
    drawn = draw_street(rng=np.random.default_rng(3))
    for seed in range(5):
        view = draw_view(drawn, rng=np.random.default_rng(seed), is_exact=True)
        real = view.objects != CLUTTER
        np.testing.assert_array_equal(view.positions[real], drawn.positions[view.objects[real]])
        np.testing.assert_array_equal(view.labels[real], drawn.labels[view.objects[real]])


def test_damaged_weights_are_refused(folder: Path, tmp_path: Path) -> None:
    content = (folder / WEIGHTS).read_bytes()
    for path, written in (("half", content[: len(content) // 2]), ("text", b"no weights")):
        (tmp_path / f"{path}.safetensors").write_bytes(written)
        with pytest.raises(WeightsError, match="truncated"):
            LearnedLikelihood(tmp_path / f"{path}.safetensors")
    with pytest.raises(WeightsError, match="no such file"):
        LearnedLikelihood(tmp_path / "none.safetensors")


@pytest.mark.parametrize(
    ("metadata", "tensors", "told"),
    [
        ({"architecture": "{"}, {}, "metadata are damaged"),
        ({"architecture": "[" * 100_000}, {}, "metadata are damaged"),
        ({"architecture": "3"}, {}, "metadata are damaged"),
        ({"architecture": '{"radius_m": 60.0}'}, {}, "metadata are damaged"),
        ({}, {"log_width": np.zeros(2, np.float32)}, "not those of its architecture"),
        ({}, {"ring.2.bias": np.full(2, np.nan, np.float32)}, "not those of its architecture"),
        ({"radius_m": 1e300}, {}, "not those of its architecture"),
        ({"least_ring_m": 0.0}, {}, "not those of its architecture"),
    ],
)
def test_weights_that_do_not_fit_are_refused(folder, tmp_path, metadata, tensors, told):
    with safe_open(folder / WEIGHTS, framework="np") as file:
        right = {name: file.get_tensor(name) for name in file.keys()}  # noqa: SIM118
        texts = dict(file.metadata())
    architecture = json.loads(texts["architecture"])
    texts["architecture"] = metadata.get("architecture", json.dumps(architecture | metadata))
    save_file(right | tensors, tmp_path / WEIGHTS, texts)
    with pytest.raises(WeightsError, match=told):
        LearnedLikelihood(tmp_path / WEIGHTS)
