"""The trainer: it learns, and the same recipe gives the same weights."""

import csv
import importlib.metadata
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch

from descriptors.descriptellation.network import DescriptellationArchitecture
from descriptors.learned.weights import read_weights
from descriptors.training import trainer
from descriptors.training.contrast import ContrastTraining
from descriptors.training.maps import TrainingMap
from descriptors.training.trainer import CURVES, WEIGHTS, Epoch, Recipe, best_of, train
from tests.helpers.trainings import short_trainings

LIKELIHOOD = ContrastTraining(epochs=2, validation_maps=2, objects_per_map=30, views=1)
NETWORK = replace(
    LIKELIHOOD, architecture=DescriptellationArchitecture(layers=2, channels=8, fusion=8, length=16), learning_rate=1e-3
)
MakeRecipe = Callable[..., Recipe]


@pytest.fixture(autouse=True, scope="module")
def _short_trainings() -> Iterator[None]:
    with short_trainings():
        yield


@pytest.fixture(scope="module", params=[NETWORK, LIKELIHOOD], ids=["network", "likelihood"])
def make(request: pytest.FixtureRequest) -> MakeRecipe:
    return lambda **changes: Recipe(replace(request.param, **changes))


@pytest.fixture(scope="module")
def folder(make, tmp_path_factory) -> Path:
    """A finished training."""
    folder = tmp_path_factory.mktemp("finished")
    train(make(), folder, threads=1)
    return folder


def curves(folder: Path) -> list[dict[str, str]]:
    with (folder / CURVES).open(newline="", encoding="utf-8") as file:
        return [{name: value for name, value in row.items() if name != "seconds"} for row in csv.DictReader(file)]


@pytest.mark.slow
def test_network_learns_what_holds_for_other_maps_too(tmp_path, monkeypatch):
    monkeypatch.setattr(trainer, "STEPS_PER_EPOCH", 30)
    config = replace(NETWORK, epochs=4, validation_maps=8, views=3, objects_per_map=60)
    learned = train(Recipe(replace(config, learning_rate=1e-2)), tmp_path / "learned", threads=1)
    idle = train(Recipe(replace(config, learning_rate=1e-9, last_rate=1e-9)), tmp_path / "idle", threads=1)
    assert learned[-1]["validation_loss"] < 0.9 * idle[-1]["validation_loss"]
    assert best_of(learned)["validation_top_5"] > best_of(idle)["validation_top_5"] + 0.05


@pytest.mark.parametrize("seed", [0, 1])
def test_the_seed_decides_the_bytes(make, folder, tmp_path, seed):
    torch.manual_seed(99)  # nothing outside decides
    train(make(seed=seed), tmp_path, threads=1)
    assert ((tmp_path / WEIGHTS).read_bytes() == (folder / WEIGHTS).read_bytes()) is (seed == 0)
    assert (curves(tmp_path) == curves(folder)) is (seed == 0)


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

    def further(name: str, rate: float = 1e-4) -> list[Epoch]:
        config = replace(NETWORK, learning_rate=rate, last_rate=0.1 * rate)
        return train(Recipe(config, given, start), tmp_path / name, threads=1)

    epochs = further("further")
    assert [(each["epoch"], each["train_loss"] is None) for each in epochs] == [(0, True), (1, False), (2, False)]
    # Which epoch is best after steps so large depends on the rounding of the machine.
    best = best_of(further("ruined", rate=50.0))["epoch"]
    kept, before = (read_weights(path) for path in (tmp_path / "ruined" / WEIGHTS, start))
    assert kept.metrics["epoch"] == best
    are_equal = all(np.array_equal(kept.tensors[name], before.tensors[name]) for name in before.tensors)
    assert are_equal is (best == 0)
