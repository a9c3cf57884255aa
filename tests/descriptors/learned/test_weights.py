"""Files of weights: what was written comes back, and what does not fit is refused by name."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import asdict, replace
from pathlib import Path

import numpy as np
import pytest
import torch
from numpy.typing import NDArray
from safetensors import safe_open
from safetensors.numpy import load_file, save_file
from torch import Tensor, nn

from descriptors.descriptellation.network import DescriptellationArchitecture
from descriptors.descriptellation_lr.likelihood import LearnedLikelihood
from descriptors.descriptellation_lr.network import DescriptellationLR
from descriptors.errors import DescriptorError, WeightsError
from descriptors.learned.networks import load_network, make_network
from descriptors.learned.weights import Weights, read_weights, save_weights

SMALL = DescriptellationArchitecture(layers=2, channels=8, fusion=8, length=16)
Tensors = dict[str, NDArray[np.float32]]
Texts = dict[str, str]


def weights_of(network: nn.Module) -> Weights:
    tensors = {name: tensor.detach().numpy() for name, tensor in network.state_dict().items()}
    architecture = asdict(network.architecture)  # type: ignore[call-overload]
    return Weights(tensors, architecture, {"epochs": 3, "rate": 1e-3}, 5, "0.1.0", {"top5": 0.9})


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


@pytest.fixture
def likelihood(tmp_path) -> Path:
    path = tmp_path / "lr.safetensors"
    save_weights(path, weights_of(DescriptellationLR()))
    return path


def rewrite(path: Path, change: Callable[[Tensors, Texts], object], *, is_signed: bool = False) -> None:
    """The same file with tensors and metadata changed, and the digest left as it was unless it ``is_signed``."""
    tensors = load_file(path)
    with safe_open(path, framework="np") as file:
        texts = file.metadata()
    change(tensors, texts)
    if is_signed:
        fields = {name: json.loads(text) for name, text in texts.items() if name not in ("format_version", "sha256")}
        save_weights(path, Weights(tensors, **fields))
    else:
        save_file(tensors, path, metadata=texts)


def set_architecture(texts: Texts, **values: object) -> None:
    texts["architecture"] = json.dumps(json.loads(texts["architecture"]) | values)


def test_network_comes_back_with_its_architecture_results_and_history(tmp_path):
    architecture = DescriptellationArchitecture(length=24)
    network = trained(architecture)
    save_weights(tmp_path / "net", weights_of(network))
    torch.manual_seed(7)
    expected = torch.rand(3)
    torch.manual_seed(7)
    loaded, weights = load_network(tmp_path / "net")
    assert torch.equal(torch.rand(3), expected)  # loading draws no random numbers
    assert (weights.training, weights.seed, weights.metrics) == ({"epochs": 3, "rate": 1e-3}, 5, {"top5": 0.9})
    assert loaded.architecture == architecture
    assert not loaded.training
    assert torch.equal(loaded(*constellations()), network.eval()(*constellations()))
    loaded.train()(*constellations())[:, 0].sum().backward()
    assert all(parameter.grad is not None for parameter in loaded.parameters())


def test_equal_weights_give_equal_bytes_and_readable_metadata(path, tmp_path):
    save_weights(tmp_path / "again", weights_of(trained()))
    assert (tmp_path / "again").read_bytes() == path.read_bytes()
    with safe_open(path, framework="np") as file:
        assert json.loads(file.metadata()["architecture"]) == asdict(SMALL)


def test_file_that_cannot_be_finished_leaves_the_old_one(path):
    before = path.read_bytes()
    weights = weights_of(trained())
    with pytest.raises(WeightsError, match="metadata"):
        save_weights(path, replace(weights, metrics={"top5": float("nan")}))
    path.with_name(path.name + ".part").mkdir()
    with pytest.raises(WeightsError, match=str(path)):
        save_weights(path, weights)
    assert path.read_bytes() == before


@pytest.mark.parametrize("content", [b"", b"weights, honestly" * 100, None])
def test_missing_or_damaged_file_is_refused(path, content):
    for kept in (0, 5, 300, -1) if content == b"" else (None,):
        path.write_bytes(path.read_bytes()[:kept] if content == b"" else content or b"")
        with pytest.raises(WeightsError, match=r"net.safetensors: truncated, or not a safetensors file"):
            read_weights(path)
    with pytest.raises(WeightsError, match="no such file"):
        read_weights(path.with_name("nowhere"))


def swap(tensors: Tensors, _: Texts) -> None:
    names = "pooling.gate.weight", "pooling.theta.weight"
    tensors[names[0]], tensors[names[1]] = tensors[names[1]], tensors[names[0]]


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (swap, "SHA-256"),
        (lambda _, texts: texts.update(architecture="{"), r"readable 'architecture'"),
        (lambda _, texts: texts.update(architecture="[1]"), r"'architecture' .*\[1\]"),
        (lambda _, texts: texts.update(format_version="2"), r"format version '2'.*'1'"),
        (lambda _, texts: texts.clear(), r"format version None"),
        (lambda _, texts: texts.pop("sha256"), r"the file says None"),
        (lambda _, texts: texts.pop("seed"), r"readable 'seed'"),
    ],
)
def test_altered_file_is_refused_by_what_was_altered(path, change, message):
    rewrite(path, lambda tensors, texts: None)
    read_weights(path)
    rewrite(path, change)
    with pytest.raises(WeightsError, match=rf"net\.safetensors: .*{message}"):
        read_weights(path)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda tensors, _: tensors.pop("fusion.0.bias"), r"no tensor fusion\.0\.bias.*\(8,\)"),
        (lambda tensors, _: tensors.update(extra=np.zeros(3)), r"tensor extra of shape \(3,\) has no place"),
        (lambda tensors, _: tensors.update({"fusion.0.bias": np.zeros(9)}), r"fusion\.0\.bias.*\(9,\).*\(8,\)"),
        (lambda tensors, _: tensors.update({"fusion.0.bias": np.zeros(8)}), r"fusion\.0\.bias is float64.*float32"),
        (lambda _, texts: set_architecture(texts, channels=16), r"tensor backbone\.0.*\(8,.*\(16,"),
        (lambda _, texts: set_architecture(texts, name="transformer"), r"unknown network 'transformer'"),
        (lambda _, texts: set_architecture(texts, heads=4), r"unknown fields \['heads'\]"),
        (lambda _, texts: set_architecture(texts, channels="8"), r"channels = '8'"),
        (lambda _, texts: texts.update(architecture='{"name": "descriptellation"}'), r"no fields \['channels'"),
    ],
)
def test_network_that_does_not_fit_its_architecture_is_refused_by_name(path, change, message):
    rewrite(path, change, is_signed=True)
    with pytest.raises(WeightsError, match=rf"net\.safetensors: .*{message}"):
        load_network(path)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda _, texts: texts.update(architecture='{"radius_m": 60.0}'), "no fields"),
        (lambda tensors, _: tensors.update(log_width=np.zeros(2, np.float32)), "log_width is float32"),
        (lambda tensors, _: tensors.update({"ring.2.bias": np.full(2, np.nan, np.float32)}), "not finite"),
        (lambda _, texts: set_architecture(texts, radius_m=1e300), "its rings are invalid"),
        (lambda _, texts: set_architecture(texts, least_ring_m=0.0), "its rings are invalid"),
    ],
)
def test_likelihood_that_does_not_fit_its_architecture_is_refused(likelihood, change, message):
    LearnedLikelihood(likelihood)
    rewrite(likelihood, change, is_signed=True)
    with pytest.raises(DescriptorError, match=message):
        LearnedLikelihood(likelihood)
