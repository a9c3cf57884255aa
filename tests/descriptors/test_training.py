"""The trainer: it learns, it can be interrupted, and the same recipe gives the same weights."""

from __future__ import annotations

import csv
import importlib.metadata
import shutil
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch

from descriptors.descriptellation.network import DescriptellationArchitecture
from descriptors.errors import DescriptorError
from descriptors.learned.networks import default_architecture
from descriptors.learned.weights import read_weights
from descriptors.training import trainer
from descriptors.training.contrast import ContrastTraining
from descriptors.training.folder import CHECKPOINT, CURVES, WEIGHTS, Epoch
from descriptors.training.maps import TrainingMap
from descriptors.training.trainer import Recipe, best_of, train

LIKELIHOOD = ContrastTraining(epochs=2, validation_maps=2, objects_per_map=30, views=1)
NETWORK = replace(
    LIKELIHOOD, architecture=DescriptellationArchitecture(layers=2, channels=8, fusion=8, length=16), learning_rate=1e-3
)
MakeRecipe = Callable[..., Recipe]


class InterruptionError(Exception):
    """What stops a training."""


@pytest.fixture(autouse=True, scope="module")
def short_trainings() -> Iterator[None]:
    """A training sets threads and determinism for the whole process."""
    threads, deterministic = torch.get_num_threads(), torch.are_deterministic_algorithms_enabled()
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(trainer, "STEPS_PER_EPOCH", 2)
        yield
    torch.set_num_threads(threads)
    torch.use_deterministic_algorithms(deterministic)


@pytest.fixture(scope="module", params=[NETWORK, LIKELIHOOD], ids=["network", "likelihood"])
def make(request: pytest.FixtureRequest) -> MakeRecipe:
    return lambda **changes: Recipe(replace(request.param, **changes))


@pytest.fixture(scope="module")
def folder(make, tmp_path_factory) -> Path:
    """A training that nobody interrupted."""
    folder = tmp_path_factory.mktemp("uninterrupted")
    train(make(), folder, threads=1)
    return folder


def curves(folder: Path) -> list[dict[str, str]]:
    with (folder / CURVES).open(newline="", encoding="utf-8") as file:
        return [{name: value for name, value in row.items() if name != "seconds"} for row in csv.DictReader(file)]


@pytest.mark.slow
def test_network_learns_what_holds_for_other_maps_too(tmp_path, monkeypatch):
    monkeypatch.setattr(trainer, "STEPS_PER_EPOCH", 15)
    config = replace(NETWORK, epochs=4, validation_maps=8, views=3, objects_per_map=60)
    learned = train(Recipe(replace(config, learning_rate=1e-2)), tmp_path / "learned", threads=1)
    idle = train(Recipe(replace(config, learning_rate=1e-9, last_rate=1e-9)), tmp_path / "idle", threads=1)
    assert learned[-1].metrics["validation_loss"] < 0.9 * idle[-1].metrics["validation_loss"]
    assert best_of(learned).metrics["validation_top_5"] > best_of(idle).metrics["validation_top_5"] + 0.05


def test_another_seed_gives_other_bytes(make, folder, tmp_path):
    train(make(seed=1), tmp_path, threads=1)
    assert (tmp_path / WEIGHTS).read_bytes() != (folder / WEIGHTS).read_bytes()


def test_interrupted_training_ends_with_the_same_bytes(make, folder, tmp_path):
    torch.manual_seed(99)  # nothing outside decides
    steps: list[float] = []

    def interrupt(fraction: float) -> None:
        steps.append(fraction)
        if len(steps) == 3:
            raise InterruptionError

    with pytest.raises(InterruptionError):
        train(make(), tmp_path, threads=1, on_progress=interrupt)
    train(make(), tmp_path, threads=1)
    assert (tmp_path / WEIGHTS).read_bytes() == (folder / WEIGHTS).read_bytes()
    assert curves(tmp_path) == curves(folder)


def test_complete_training_is_left_as_it_is(make, folder):
    before = {path.name: path.read_bytes() for path in folder.iterdir()}
    steps: list[float] = []
    epochs = train(make(), folder, threads=1, on_progress=steps.append)
    assert steps == []
    assert [each.epoch for each in epochs] == list(range(1, len(epochs) + 1))
    assert {path.name: path.read_bytes() for path in folder.iterdir()} == before
    assert set(before) == {CHECKPOINT, CURVES, WEIGHTS}


@pytest.mark.parametrize(
    ("changes", "given", "named"),
    [
        ({"seed": 1}, (), "seed"),
        ({"architecture": DescriptellationArchitecture()}, (), "architecture"),
        ({}, [TrainingMap(np.zeros((5, 3)), np.zeros(5, np.int64), 1)], "maps"),
    ],
)
def test_checkpoint_of_another_recipe_is_refused_and_kept(make, folder, changes, given, named):
    before = (folder / CHECKPOINT).read_bytes()
    with pytest.raises(DescriptorError, match=rf"{folder / CHECKPOINT}: .*another configuration.*{named}.*delete it"):
        train(Recipe(replace(make().config, **changes), given), folder, threads=1)
    assert (folder / CHECKPOINT).read_bytes() == before


def truncated(content: bytes) -> bytes:
    return content[: len(content) // 2]


def altered(content: bytes) -> bytes:
    return content[:-9] + b"x" + content[-8:]


@pytest.mark.parametrize("spoil", [truncated, altered])
def test_damaged_checkpoint_is_refused(make, folder, tmp_path, spoil):
    shutil.copytree(folder, tmp_path / "copy")
    path = tmp_path / "copy" / CHECKPOINT
    path.write_bytes(spoil(path.read_bytes()))
    with pytest.raises(DescriptorError, match=rf"{path}: cannot be read: .*delete it"):
        train(make(), tmp_path / "copy", threads=1)


def test_learning_rate_decays_as_a_cosine(tmp_path):
    recipe = Recipe(NETWORK)
    rates: list[float] = []
    train(recipe, tmp_path, threads=1, on_progress=lambda _: rates.append(recipe.schedule.get_last_lr()[0]))
    halves, first = 0.5 * (1.0 + np.cos(np.pi * np.arange(1, 5) / 4)), recipe.config.learning_rate
    assert rates == pytest.approx(3e-4 + (first - 3e-4) * halves)


def test_weights_are_those_of_the_best_epoch_and_say_how_they_were_trained(folder):
    weights = read_weights(folder / WEIGHTS)
    rows = curves(folder)
    assert weights.metrics["validation_top_5"] == max(float(row["validation_top_5"]) for row in rows)
    assert float(rows[int(weights.metrics["epoch"]) - 1]["validation_loss"]) == weights.metrics["validation_loss"]
    assert weights.training["architecture"] == weights.architecture
    assert weights.seed == 0
    assert weights.code_version == importlib.metadata.version("descriptellation-slam")


def test_weights_that_are_trained_further_compete_with_the_weights_before(tmp_path):
    train(Recipe(NETWORK), tmp_path / "first", threads=1)
    rng = np.random.default_rng(1)
    given = [TrainingMap(rng.normal(0.0, 60.0, (200, 3)), rng.integers(4, size=200), 4)]
    start = tmp_path / "first" / WEIGHTS

    def further(name: str, start: Path = start, rate: float = 1e-4) -> list[Epoch]:
        config = replace(NETWORK, learning_rate=rate, last_rate=0.1 * rate)
        return train(Recipe(config, given, start), tmp_path / name, threads=1)

    epochs = further("further")
    assert [(each.epoch, each.train_loss is None) for each in epochs] == [(0, True), (1, False), (2, False)]
    assert further("further") == epochs
    further("ruined", rate=50.0)
    kept, before = (read_weights(path).tensors for path in (tmp_path / "ruined" / WEIGHTS, start))
    assert all(np.array_equal(kept[name], before[name]) for name in before)
    with pytest.raises(DescriptorError, match=r"another configuration \(start\)"):
        further("further", start=tmp_path / "ruined" / WEIGHTS)


def test_network_that_does_not_exist_is_refused():
    assert default_architecture("descriptellation") == DescriptellationArchitecture()
    with pytest.raises(DescriptorError, match=r"unknown network 'transformer'; choose descriptellation"):
        default_architecture("transformer")
