"""Training: it learns, it can be interrupted, and the same configuration gives the same weights."""

from __future__ import annotations

import csv
import importlib.metadata
import shutil
from collections.abc import Callable, Iterator
from dataclasses import asdict, fields, replace
from pathlib import Path

import numpy as np
import pytest
import torch

from descriptors.baselines.pointnet import PointNetArchitecture
from descriptors.baselines.sgnet import SGNetArchitecture
from descriptors.descriptellation import training
from descriptors.descriptellation.dataset import DatasetConfig, make_dataset
from descriptors.descriptellation.network import DescriptellationArchitecture
from descriptors.descriptellation.training import Epoch, TrainingConfig, train_network
from descriptors.errors import DescriptorError
from descriptors.learned.architectures import default_architecture
from descriptors.learned.inference import describe_padded
from descriptors.learned.training_folder import CHECKPOINT, CURVES, WEIGHTS
from descriptors.learned.weights import load_weights
from descriptors.top_k import top_k_ratio

TINY = TrainingConfig(
    architecture=DescriptellationArchitecture(layers=2, channels=8, fusion=8, length=16),
    dataset=DatasetConfig(anchors=20, positives=3),
    epochs=4,
    anchors_per_batch=5,
    learning_rate=1e-2,
    decay_epochs=3,
)


class InterruptionError(Exception):
    """What stops a training."""


@pytest.fixture(autouse=True)
def torch_as_it_was() -> Iterator[None]:
    """A training sets threads and determinism for the whole process."""
    threads, deterministic = torch.get_num_threads(), torch.are_deterministic_algorithms_enabled()
    yield
    torch.set_num_threads(threads)
    torch.use_deterministic_algorithms(deterministic)


@pytest.fixture(scope="module")
def folder(tmp_path_factory) -> Path:
    """A training that nobody interrupted."""
    folder = tmp_path_factory.mktemp("uninterrupted")
    train(TINY, folder)
    return folder


def train(config: TrainingConfig, folder: Path, on_epoch: Callable[[Epoch], None] = lambda epoch: None) -> list[Epoch]:
    return train_network(config, folder, threads=1, on_epoch=on_epoch)


def interrupt_after(epochs: int) -> Callable[[Epoch], None]:
    def report(epoch: Epoch) -> None:
        if epoch.epoch == epochs:
            raise InterruptionError

    return report


def without_time(epochs: list[Epoch]) -> list[Epoch]:
    return [replace(epoch, seconds=0.0) for epoch in epochs]


@pytest.mark.slow
@pytest.mark.parametrize("seed", [1, 2])
def test_it_learns_what_holds_for_other_maps_too(tmp_path, seed):
    dataset = DatasetConfig(anchors=40, positives=3)
    config = replace(TINY, dataset=dataset, epochs=12, seed=seed, learning_rate=3e-3, decay_epochs=10)
    learned = train(config, tmp_path / "learned")
    idle = train(replace(config, learning_rate=0.0), tmp_path / "idle")
    assert min(epoch.train_loss for epoch in learned) < 0.8 * learned[0].train_loss
    assert min(epoch.train_loss for epoch in idle) > 0.85 * idle[0].train_loss
    assert learned[-1].train_top_k > idle[-1].train_top_k + 0.3
    chance = 1.0 - np.prod([(156 - i) / (159 - i) for i in range(config.top_k)])
    best, best_idle = (max(epoch.validation_top_k for epoch in epochs) for epochs in (learned, idle))
    assert best > max(2.5 * chance, best_idle + 0.04)


@pytest.mark.slow
@pytest.mark.parametrize(
    "architecture", [PointNetArchitecture(length=16), SGNetArchitecture(length=16)], ids=lambda a: a.name
)
def test_the_other_networks_learn_too(tmp_path, architecture):
    config = replace(TINY, architecture=architecture, epochs=3, learning_rate=1e-3)
    epochs = train(config, tmp_path)
    assert epochs[-1].train_loss < epochs[0].train_loss
    assert load_weights(tmp_path / WEIGHTS)[0].architecture == architecture


def test_the_same_configuration_gives_the_same_bytes_and_another_seed_others(folder, tmp_path):
    torch.manual_seed(99)  # nothing outside decides
    train(TINY, tmp_path / "again")
    train(replace(TINY, seed=1), tmp_path / "other")
    expected = (folder / WEIGHTS).read_bytes()
    assert (tmp_path / "again" / WEIGHTS).read_bytes() == expected
    assert (tmp_path / "other" / WEIGHTS).read_bytes() != expected


@pytest.mark.parametrize("after", [1, 2, 3])
def test_an_interrupted_training_ends_with_the_same_bytes(folder, tmp_path, after):
    with pytest.raises(InterruptionError):
        train(TINY, tmp_path, interrupt_after(after))
    told: list[int] = []
    epochs = train(TINY, tmp_path, lambda epoch: told.append(epoch.epoch))
    assert told == list(range(after + 1, 5))
    assert [epoch.epoch for epoch in epochs] == [1, 2, 3, 4]
    assert (tmp_path / WEIGHTS).read_bytes() == (folder / WEIGHTS).read_bytes()
    assert states(tmp_path) == states(folder)
    assert curves(tmp_path) == curves(folder)


def test_an_epoch_that_was_interrupted_before_its_checkpoint_is_gone_through_again(folder, tmp_path, monkeypatch):
    saved: list[int] = []
    save = torch.save

    def fail(state: object, path: Path) -> None:
        saved.append(1)
        if len(saved) == 3:
            raise InterruptionError
        save(state, path)

    monkeypatch.setattr(torch, "save", fail)
    with pytest.raises(InterruptionError):
        train(TINY, tmp_path)
    told: list[int] = []
    train(TINY, tmp_path, lambda epoch: told.append(epoch.epoch))
    assert told == [3, 4]
    assert (tmp_path / WEIGHTS).read_bytes() == (folder / WEIGHTS).read_bytes()
    assert states(tmp_path) == states(folder)


def states(folder: Path) -> dict[str, list[float]]:
    """The last weights and what Adam remembers, which the weights of the best epoch alone would not show."""
    state = torch.load(folder / CHECKPOINT, weights_only=True)
    memories = {
        f"{parameter}.{name}": tensor
        for parameter, memory in state["optimizer"]["state"].items()
        for name, tensor in memory.items()
    }
    return {str(name): tensor.flatten().tolist() for name, tensor in {**state["network"], **memories}.items()}


def test_a_training_that_is_complete_is_left_as_it_is(folder):
    before = {path.name: path.read_bytes() for path in folder.iterdir()}
    told: list[Epoch] = []
    epochs = train(TINY, folder, told.append)
    assert told == []
    assert len(epochs) == 4
    assert {path.name: path.read_bytes() for path in folder.iterdir()} == before
    assert set(before) == {CHECKPOINT, CURVES, WEIGHTS}


@pytest.mark.parametrize(
    "other",
    [
        replace(TINY, seed=1),
        replace(TINY, margin=0.2),
        replace(TINY, dataset=replace(TINY.dataset, radius_m=25.0)),
        replace(TINY, architecture=replace(TINY.architecture, channels=16)),  # type: ignore[type-var]
        replace(TINY, architecture=PointNetArchitecture()),
        replace(TINY, augmentation=replace(TINY.augmentation, dropout=0.2)),
    ],
    ids=["seed", "margin", "dataset", "sizes", "network", "augmentation"],
)
def test_the_checkpoint_of_another_configuration_is_refused_and_kept(folder, other):
    before = (folder / CHECKPOINT).read_bytes()
    with pytest.raises(DescriptorError, match=rf"{folder / CHECKPOINT}: .*another configuration.*delete it"):
        train(other, folder)
    assert (folder / CHECKPOINT).read_bytes() == before


def test_a_finished_training_goes_on_where_more_epochs_are_asked_for(folder, tmp_path):
    longer = replace(TINY, epochs=TINY.epochs + 1)
    copied = tmp_path / "copied"
    shutil.copytree(folder, copied)
    train(longer, copied)
    train(longer, tmp_path / "afresh")
    assert (copied / WEIGHTS).read_bytes() == (tmp_path / "afresh" / WEIGHTS).read_bytes() or (
        load_weights(copied / WEIGHTS)[1].metrics == load_weights(tmp_path / "afresh" / WEIGHTS)[1].metrics
    )
    assert len(curves(copied)) == longer.epochs


@pytest.mark.parametrize("share", [0.0, 0.01, 0.5, 0.99])
def test_a_truncated_checkpoint_is_refused(folder, tmp_path, share):
    content = (folder / CHECKPOINT).read_bytes()
    (tmp_path / CHECKPOINT).write_bytes(content[: int(share * len(content))])
    with pytest.raises(DescriptorError, match=rf"{tmp_path / CHECKPOINT}: cannot be read: .*delete it"):
        train(TINY, tmp_path)


def test_an_altered_checkpoint_is_refused(folder, tmp_path):
    state = torch.load(folder / CHECKPOINT, weights_only=True)
    del state["optimizer"]["state"][0]["step"]
    torch.save(state, tmp_path / CHECKPOINT)
    with pytest.raises(DescriptorError, match="cannot be read: it was altered, or is of another version; delete it"):
        train(TINY, tmp_path)


@pytest.mark.parametrize("content", [{}, {"config": "{}", "epochs": "x"}, [1, 2]], ids=["empty", "no epochs", "list"])
def test_what_is_no_checkpoint_is_refused(tmp_path, content):
    torch.save(content, tmp_path / CHECKPOINT)
    with pytest.raises(DescriptorError, match=r"checkpoint\.pt: cannot be read"):
        train(TINY, tmp_path)


def test_a_checkpoint_that_would_run_code_is_refused(tmp_path):
    torch.save({"config": Path("anything")}, tmp_path / CHECKPOINT)
    with pytest.raises(DescriptorError, match=r"checkpoint\.pt: cannot be read"):
        train(TINY, tmp_path)


def curves(folder: Path) -> list[dict[str, str]]:
    with (folder / CURVES).open(newline="", encoding="utf-8") as file:
        return [{name: value for name, value in row.items() if name != "seconds"} for row in csv.DictReader(file)]


def test_the_curves_have_a_line_for_each_epoch_after_each_epoch(tmp_path):
    lines: list[int] = []
    epochs = train(TINY, tmp_path, lambda epoch: lines.append(len(curves(tmp_path))))
    assert lines == [1, 2, 3, 4]
    names = (tmp_path / CURVES).read_text().splitlines()[0].split(",")
    assert names == [field.name for field in fields(Epoch)]
    for row, epoch in zip(curves(tmp_path), epochs, strict=True):
        assert {name: float(value) for name, value in row.items()} == {
            name: value for name, value in asdict(epoch).items() if name != "seconds"
        }


def test_every_epoch_is_told_when_its_files_are_there(tmp_path):
    told: list[Epoch] = []

    def report(epoch: Epoch) -> None:
        assert {path.name for path in tmp_path.iterdir()} == {CHECKPOINT, CURVES, WEIGHTS}
        told.append(epoch)

    assert train(TINY, tmp_path, report) == told
    assert [epoch.epoch for epoch in told] == [1, 2, 3, 4]
    assert all(epoch.seconds > 0.0 for epoch in told)


def test_each_batch_tells_how_far_the_training_is_and_how_long_the_rest_takes(tmp_path):
    told: list[tuple[float, float, float]] = []
    train_network(
        replace(TINY, epochs=2), tmp_path, threads=1, on_batch=lambda done, loss, left: told.append((done, loss, left))
    )
    assert [done for done, _, _ in told] == pytest.approx([0.125 * k for k in range(1, 9)])
    assert all(loss > 0.0 for _, loss, _ in told)
    assert told[-1][2] == 0.0 < told[0][2]


def test_the_learning_rate_decays_by_steps(tmp_path):
    epochs = train(replace(TINY, epochs=7), tmp_path)
    assert [epoch.learning_rate for epoch in epochs] == pytest.approx([1e-2] * 3 + [7e-3] * 3 + [4.9e-3])


def test_the_weights_say_where_they_come_from(folder):
    network, metadata = load_weights(folder / WEIGHTS)
    assert network.architecture == TINY.architecture
    assert metadata.training == TINY.as_json()
    assert metadata.training["dataset"]["radius_m"] == 30.0
    assert metadata.seed == TINY.seed
    assert metadata.code_version == importlib.metadata.version("descriptellation-slam")
    assert set(metadata.metrics) == {field.name for field in fields(Epoch)} - {"seconds"}


def test_the_weights_are_those_of_the_best_epoch_and_achieve_what_they_say(folder):
    network, metadata = load_weights(folder / WEIGHTS)
    rows = curves(folder)
    assert metadata.metrics["validation_top_k"] == max(float(row["validation_top_k"]) for row in rows)
    assert float(rows[int(metadata.metrics["epoch"]) - 1]["validation_loss"]) == metadata.metrics["validation_loss"]
    torch.set_num_threads(1)
    for seed, name in ((2 * TINY.seed, "train_top_k"), (2 * TINY.seed + 1, "validation_top_k")):
        dataset = make_dataset(TINY.simulation, TINY.augmentation, TINY.dataset, seed=seed)
        described = describe_padded(network, dataset.constellations, torch.device("cpu"))
        assert top_k_ratio(described, dataset.anchors, TINY.top_k) == metadata.metrics[name]


def test_of_epochs_that_are_equally_good_the_first_one_counts(tmp_path, monkeypatch):
    ratios = iter([0.1, 0.5, 0.1, 0.5, 0.1, 0.5, 0.1, 0.4])  # of the training maps and of the validation maps, in turn
    monkeypatch.setattr(training, "top_k_ratio", lambda vectors, things, k: next(ratios))
    train(TINY, tmp_path)
    assert load_weights(tmp_path / WEIGHTS)[1].metrics["epoch"] == 1


def test_an_epoch_goes_through_every_view_once_anchor_by_anchor_and_each_time_in_another_order(tmp_path, monkeypatch):
    batches: list[list[int]] = []
    loss = training.batch_triplet_loss  # type: ignore[attr-defined]

    def note(vectors: torch.Tensor, anchors: torch.Tensor, margin: float) -> torch.Tensor:
        if vectors.requires_grad:
            batches.append(anchors.tolist())
        return loss(vectors, anchors, margin)

    monkeypatch.setattr(training, "batch_triplet_loss", note)
    train(replace(TINY, anchors_per_batch=6, epochs=2), tmp_path)
    assert [len(batch) for batch in batches] == [24, 24, 24, 8] * 2
    for epoch in (batches[:4], batches[4:]):
        assert sorted(anchor for batch in epoch for anchor in batch) == sorted(list(range(20)) * 4)
        assert all(len(set(batch)) == len(batch) // 4 for batch in epoch)
    assert batches[:4] != batches[4:]


def test_default_architectures_take_settings_and_refuse_what_they_do_not_know():
    assert default_architecture("descriptellation") == DescriptellationArchitecture()
    assert default_architecture("descriptellation", input="one_hot") == DescriptellationArchitecture(input="one_hot")
    assert default_architecture("pointnet", length=24) == PointNetArchitecture(length=24)
    with pytest.raises(DescriptorError, match=r"'transformer'.*descriptellation, pointnet, sgnet"):
        default_architecture("transformer")
    with pytest.raises(DescriptorError, match=r"'pointnet' with unknown fields \['input'\]"):
        default_architecture("pointnet", input="position")
    with pytest.raises(DescriptorError, match=r"input = 'colour'"):
        default_architecture("descriptellation", input="colour")
