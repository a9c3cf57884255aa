"""dslam train, as it is typed; the trainings behind it are tiny, or none."""

from collections.abc import Callable, Iterator
from functools import partial
from pathlib import Path
from typing import Any

import pytest

from descriptors.descriptellation.network import DescriptellationArchitecture
from descriptors.descriptellation_lr.pair_index import PairIndex
from descriptors.registry import make_index
from descriptors.training import contrast, trainer
from descriptors.training.contrast import ContrastTraining
from descriptors.training.trainer import WEIGHTS, Epoch, Recipe
from tests.helpers.trainings import short_trainings
from tests.tools.runs import Run, assert_refused, assert_well

Called = dict[str, Any]


def epoch(number: int, top_5: float) -> Epoch:
    return {"epoch": number, "train_loss": 0.2 / number, "validation_top_5": top_5, "seconds": 1.5}


@pytest.fixture
def called(monkeypatch: pytest.MonkeyPatch) -> Called:
    """Arguments of a training that ends at once, the third of four epochs being the best."""
    called: Called = {}

    def fake(recipe: Recipe, folder: Path, *, on_progress: Callable[[float], None], threads: int) -> list[Epoch]:
        called.update(config=recipe.config, folder=folder, threads=threads)
        on_progress(0.5)
        return [epoch(number + 1, ratio) for number, ratio in enumerate((0.5, 0.7, 0.975, 0.8))]

    monkeypatch.setattr(trainer, "train", fake)
    return called


@pytest.fixture
def tiny() -> Iterator[None]:
    """Trainings on a few constellations."""
    made = partial(ContrastTraining, validation_maps=1, objects_per_map=20, views=1)
    with short_trainings() as patch:
        patch.setattr(contrast, "ContrastTraining", made)
        yield


def test_options_reach_the_training_and_the_best_epoch_is_told(dslam: Run, called: Called, tmp_path: Path) -> None:
    assert dslam("train", tmp_path).code == 0
    assert called["config"] == ContrastTraining()
    options = ("--network", "descriptellation", "--epochs", 7, "--seed", 3, "--device", "cpu", "--threads", 1)
    result = assert_well(dslam("train", tmp_path / "net", *options))
    assert "epoch 3, " in result.out
    assert "validation_top_5 0.975" in result.out
    config = called.pop("config")
    assert (config.architecture, config.epochs, config.seed) == (DescriptellationArchitecture(), 7, 3)
    assert called == {"folder": tmp_path / "net", "threads": 1}
    told = dslam("train", tmp_path / "net", *options, "--json").json
    assert (told["weights"], told["epochs"]) == (str(tmp_path / "net" / WEIGHTS), 4)
    assert (told["best"]["epoch"], told["best"]["validation_top_5"]) == (3, 0.975)


@pytest.mark.slow
@pytest.mark.usefixtures("tiny")
@pytest.mark.parametrize("network", ["descriptellation_lr", "descriptellation"])
def test_maps_of_one_s_own_are_taken_and_the_weights_make_an_index(dslam: Run, tmp_path: Path, network: str) -> None:
    rows = "\n".join(f"{7.0 * (i % 9)},{5.0 * (i // 9)},0,{('lamp', 'bin')[i % 2]},o{i}" for i in range(60))
    (tmp_path / "town.csv").write_text(f"x_m,y_m,z_m,class,id\n{rows}\n", encoding="utf-8")
    typed = ("train", tmp_path / "net", "--network", network, "--maps", tmp_path / "town.csv", "--epochs", 1, "--json")
    result = dslam(*typed)
    curves = (tmp_path / "net" / "curves.csv").read_text(encoding="utf-8").splitlines()
    assert [line.split(",")[0] for line in curves] == ["epoch", "0", "1"]  # 0: the shipped weights
    assert result.code == 0, result.err
    path = tmp_path / "net" / WEIGHTS
    assert result.json["weights"] == str(path)
    assert isinstance(make_index(str(path)), PairIndex) == (network == "descriptellation_lr")


@pytest.mark.usefixtures("tiny")
@pytest.mark.parametrize(
    ("rows", "told"), [("", "holds no object"), ("0,0\n500,3\n900,5\n", "no place in the maps has enough objects")]
)
def test_train_refuses_a_map_with_too_few_objects(dslam: Run, tmp_path: Path, rows: str, told: str) -> None:
    (tmp_path / "town.csv").write_text(f"x_m,y_m\n{rows}", encoding="utf-8")
    assert_refused(dslam("train", tmp_path / "net", "--maps", tmp_path / "town.csv", "--epochs", 1), told)


@pytest.mark.usefixtures("tiny")
@pytest.mark.parametrize(
    ("options", "told"),
    [
        (("--anew",), ("--anew", "--maps")),
        (("--network", "transformer"), ("unknown network 'transformer'; choose descriptellation_lr, d",)),
        (("--network", "descriptellation", "--device", "gpu"), ("gpu",)),
        (("--network", "descriptellation", "--device", "cuda:99"), ("cuda:99",)),
    ],
)
def test_train_refuses_options_that_do_not_fit(
    dslam: Run, tmp_path: Path, options: tuple[object, ...], told: tuple[str, ...]
) -> None:
    assert_refused(dslam("train", tmp_path / "net", *options), *told)
    assert not (tmp_path / "net").exists() or "--device" in options
