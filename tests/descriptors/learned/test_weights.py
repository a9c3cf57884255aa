"""Files of weights: what was written comes back, and what does not fit is refused by name."""

from collections.abc import Callable, Mapping
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from numpy.typing import NDArray
from safetensors.numpy import load_file, save_file
from torch import Tensor, nn

from descriptors.descriptellation.network import DescriptellationArchitecture
from descriptors.descriptellation_lr.likelihood import LearnedLikelihood
from descriptors.descriptellation_lr.network import DescriptellationLR
from descriptors.descriptellation_lr.pairs import DescriptellationLRArchitecture
from descriptors.errors import WeightsError
from descriptors.learned.networks import load_network, make_network
from descriptors.learned.weights import Weights, read_weights, save_weights

SMALL = DescriptellationArchitecture(layers=2, channels=8, fusion=8, length=16)
Tensors = dict[str, NDArray[np.float32]]


def weights_of(network: nn.Module) -> Weights:
    tensors = {name: tensor.detach().numpy() for name, tensor in network.state_dict().items()}
    architecture = asdict(network.architecture)  # type: ignore[call-overload]
    return Weights(
        tensors=tensors,
        architecture=architecture,
        training={"epochs": 3, "rate": 1e-3},
        seed=5,
        code_version="0.1.0",
        metrics={"top5": 0.9},
    )


def trained(architecture=SMALL) -> nn.Module:
    torch.manual_seed(0)
    network = make_network(architecture)
    network(*constellations())  # running statistics that are not those it started with
    return network


def constellations() -> tuple[Tensor, Tensor, Tensor]:
    generator = torch.Generator().manual_seed(1)
    positions = torch.randn(4, 6, 3, generator=generator) * 10.0
    return positions, torch.randint(0, 64, (4, 6), generator=generator), torch.ones(4, 6, dtype=torch.bool)


@pytest.fixture
def path(tmp_path) -> Path:
    path = tmp_path / "net.safetensors"
    save_weights(path, weights_of(trained()))
    return path


def test_network_comes_back_with_its_architecture_results_and_history(tmp_path):
    architecture = DescriptellationArchitecture(length=24)
    network = trained(architecture)
    save_weights(tmp_path / "net", weights_of(network))
    torch.manual_seed(7)
    expected = torch.rand(3)
    torch.manual_seed(7)
    loaded, weights = load_network(tmp_path / "net"), read_weights(tmp_path / "net")
    assert torch.equal(torch.rand(3), expected)  # loading draws no random numbers
    assert (weights.training, weights.seed, weights.metrics) == ({"epochs": 3, "rate": 1e-3}, 5, {"top5": 0.9})
    assert loaded.architecture == architecture
    assert not loaded.training
    assert torch.equal(loaded(*constellations()), network.eval()(*constellations()))
    loaded.train()(*constellations())[:, 0].sum().backward()
    assert all(parameter.grad is not None for parameter in loaded.parameters())


def test_equal_weights_give_equal_bytes(path, tmp_path):
    save_weights(tmp_path / "again", weights_of(trained()))
    assert (tmp_path / "again").read_bytes() == path.read_bytes()


def test_file_that_cannot_be_finished_leaves_the_old_one(path):
    before = path.read_bytes()
    path.with_name(path.name + ".part").mkdir()
    with pytest.raises(WeightsError, match=str(path)):
        save_weights(path, weights_of(trained()))
    assert path.read_bytes() == before


def test_missing_truncated_or_other_file_is_refused(path):
    whole = path.read_bytes()
    for content in (*(whole[:kept] for kept in (0, 5, 300, -1)), b"weights, honestly" * 100):
        path.write_bytes(content)
        with pytest.raises(WeightsError, match=r"net.safetensors: cannot be read as weights"):
            read_weights(path)
    with pytest.raises(WeightsError, match="No such file"):
        read_weights(path.with_name("nowhere"))


@pytest.mark.parametrize(
    ("texts", "message"),
    [
        ({}, "Invalid JSON"),
        ({"dslam": "{"}, "Invalid JSON"),
        ({"dslam": '{"architecture": [1]}'}, "architecture"),
        ({"dslam": '{"architecture": {}, "format_version": 1}'}, "format_version"),
        ({"format_version": "1", "architecture": "{}"}, "Invalid JSON"),
    ],
)
def test_other_metadata_are_refused(path: Path, texts: Mapping[str, str], message: str) -> None:
    save_file(load_file(path), path, metadata=dict(texts))
    with pytest.raises(WeightsError, match=rf"net\.safetensors: weights of another format: .*{message}"):
        read_weights(path)


@pytest.mark.parametrize(
    ("load", "change", "values", "message"),
    [
        (load_network, lambda tensors: tensors.pop("fusion.0.bias"), {}, r"Missing key.*fusion\.0\.bias"),
        (load_network, lambda tensors: tensors.update(extra=np.zeros(3)), {}, r"Unexpected key.*extra"),
        (load_network, None, {"channels": 16}, r"backbone\.0.*\[8,.*\[16,"),
        (load_network, None, {"channels": -1}, "negative"),
        (load_network, None, {"name": "transformer"}, "unknown network 'transformer'"),
        (load_network, None, {"heads": 4}, "heads: Unexpected"),
        (load_network, None, {"channels": "many"}, "channels: "),
        (LearnedLikelihood, None, {"kernels": 3}, "kernels: Unexpected"),
        (LearnedLikelihood, lambda tensors: tensors.update(log_widths=np.zeros(2, np.float32)), {}, "log_widths"),
        (LearnedLikelihood, lambda tensors: tensors.update(log_widths=np.zeros(3)), {}, "log_widths"),
        (
            LearnedLikelihood,
            lambda tensors: tensors.update({"worth.2.bias": np.full(2, np.nan, np.float32)}),
            {},
            "not finite",
        ),
        (LearnedLikelihood, None, {"sectors": 0}, "its sizes are invalid"),
        (LearnedLikelihood, None, {"partners": 10**9}, "its sizes are invalid"),
    ],
)
def test_weights_that_do_not_fit_their_architecture_are_refused_by_name(
    path: Path,
    load: Callable[[Path], object],
    change: Callable[[Tensors], object] | None,
    values: dict[str, Any],
    message: str,
) -> None:
    weights = weights_of(
        DescriptellationLR(DescriptellationLRArchitecture()) if load is LearnedLikelihood else trained()
    )
    save_weights(path, weights)
    load(path)
    if change:
        change(weights.tensors)
    save_weights(path, weights.model_copy(update={"architecture": weights.architecture | values}))
    with pytest.raises(WeightsError, match=rf"{path.name}: .*{message}"):
        load(path)
