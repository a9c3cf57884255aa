"""Files of weights: what was written comes back, and whatever does not fit is refused by name."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import asdict, replace
from pathlib import Path

import pytest
import torch
from safetensors import safe_open
from safetensors.torch import load_file, save_file
from torch import Tensor, nn

from descriptors.descriptellation.network import DescriptellationArchitecture
from descriptors.errors import DescriptorError, WeightsError
from descriptors.learned.architectures import ARCHITECTURES, make_network
from descriptors.learned.weights import WeightsMetadata, load_weights, save_weights

SMALL = DescriptellationArchitecture(layers=2, channels=8, fusion=8, length=16, edge_length_m=7.5)
METADATA = WeightsMetadata(training={"epochs": 3, "rate": 1e-3}, seed=5, code_version="0.1.0", metrics={"top5": 0.9})
Tensors = dict[str, Tensor]
Texts = dict[str, str]


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
    save_weights(path, trained(), METADATA)
    return path


def rewrite(path: Path, change: Callable[[Tensors, Texts], object]) -> None:
    """The same file with tensors and metadata changed, and the digest left as it was."""
    tensors = load_file(path)
    with safe_open(path, framework="pt") as file:
        texts = file.metadata()
    change(tensors, texts)
    save_file(tensors, path, metadata=texts)


def set_architecture(texts: Texts, **values: object) -> None:
    texts["architecture"] = json.dumps(json.loads(texts["architecture"]) | values)


@pytest.mark.slow
@pytest.mark.parametrize("name", sorted(ARCHITECTURES))
def test_a_network_comes_back_with_its_architecture_its_results_and_its_history(tmp_path, name):
    architecture = replace(ARCHITECTURES[name][0](), length=24)
    network = trained(architecture)
    save_weights(tmp_path / "net", network, METADATA)
    loaded, metadata = load_weights(tmp_path / "net")
    assert metadata == METADATA
    assert type(loaded) is type(network)
    assert loaded.architecture == architecture
    assert not loaded.training
    assert torch.equal(loaded(*constellations()), network.eval()(*constellations()))


def test_a_loaded_network_can_be_trained_on(path):
    network, _ = load_weights(path)
    network.train()(*constellations())[:, 0].sum().backward()
    assert all(parameter.grad is not None for parameter in network.parameters())


def test_equal_networks_give_equal_bytes_and_loading_draws_no_random_numbers(path, tmp_path):
    for attempt in range(3):
        save_weights(tmp_path / f"again{attempt}", trained(), METADATA)
        assert (tmp_path / f"again{attempt}").read_bytes() == path.read_bytes()
    torch.manual_seed(7)
    expected = torch.rand(3)
    torch.manual_seed(7)
    load_weights(path)
    assert torch.equal(torch.rand(3), expected)


def test_a_file_that_cannot_be_finished_leaves_the_old_one(path):
    before = path.read_bytes()
    with pytest.raises(WeightsError, match="metadata"):
        save_weights(path, trained(), replace(METADATA, metrics={"top5": float("nan")}))
    path.with_name(path.name + ".part").mkdir()
    with pytest.raises(WeightsError, match=str(path)):
        save_weights(path, trained(), METADATA)
    assert path.read_bytes() == before


def test_the_file_appears_under_its_name_only_when_complete(path, monkeypatch):
    monkeypatch.setattr("os.replace", lambda source, target: None)
    other = path.with_name("other")
    save_weights(other, trained(), METADATA)
    assert not other.exists()
    assert path.with_name("other.part").read_bytes() == path.read_bytes()


def test_a_missing_file_is_refused(tmp_path):
    with pytest.raises(WeightsError, match=r"nowhere: no such file"):
        load_weights(tmp_path / "nowhere")


@pytest.mark.parametrize("kept", [0, 5, 300, -1])
def test_a_truncated_file_is_refused(path, kept):
    path.write_bytes(path.read_bytes()[:kept])
    with pytest.raises(WeightsError, match=r"net.safetensors: truncated"):
        load_weights(path)


def test_a_file_that_is_no_safetensors_is_refused(path):
    path.write_bytes(b"weights, honestly" * 100)
    with pytest.raises(WeightsError, match=r"net.safetensors: .*no safetensors file"):
        load_weights(path)


def test_safetensors_of_another_program_are_refused(path):
    save_file({"a": torch.zeros(2)}, path)
    with pytest.raises(WeightsError, match=r"net.safetensors: format version None"):
        load_weights(path)


def test_one_bit_of_a_tensor_that_changed_is_refused(path):
    content = bytearray(path.read_bytes())
    content[-1] ^= 1
    path.write_bytes(content)
    with pytest.raises(WeightsError, match=r"net.safetensors: .*SHA-256"):
        load_weights(path)


def test_tensors_that_changed_places_are_refused(path):
    def swap(tensors: Tensors, _: Texts) -> None:
        tensors["pooling.gate.weight"], tensors["pooling.theta.weight"] = (
            tensors["pooling.theta.weight"],
            tensors["pooling.gate.weight"],
        )

    rewrite(path, swap)
    with pytest.raises(WeightsError, match="SHA-256"):
        load_weights(path)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda tensors, _: tensors.pop("fusion.0.bias"), r"no tensor fusion\.0\.bias.*\(8,\)"),
        (lambda tensors, _: tensors.update(extra=torch.zeros(3)), r"tensor extra of shape \(3,\) has no place"),
        (lambda tensors, _: tensors.update({"fusion.0.bias": torch.zeros(9)}), r"fusion\.0\.bias.*\(9,\).*\(8,\)"),
        (
            lambda tensors, _: tensors.update({"fusion.0.bias": torch.zeros(8, dtype=torch.float64)}),
            r"fusion\.0\.bias is torch\.float64.*torch\.float32",
        ),
        (lambda _, texts: set_architecture(texts, channels=16), r"tensor backbone\.0.*\(8,.*\(16,"),
        (lambda _, texts: set_architecture(texts, name="transformer"), r"no architecture 'transformer'"),
        (lambda _, texts: set_architecture(texts, heads=4), r"unknown fields \['heads'\]"),
        (lambda _, texts: set_architecture(texts, channels="8"), r"channels = '8'"),
        (lambda _, texts: texts.update(architecture="{"), r"readable 'architecture'"),
        (lambda _, texts: texts.update(architecture="[1]"), r"'architecture' .*\[1\]"),
        (lambda _, texts: texts.update(format_version="2"), r"format version '2'.*'1'"),
        (lambda _, texts: texts.pop("sha256"), r"the file says None"),
        (lambda _, texts: texts.pop("seed"), r"readable 'seed'"),
    ],
)
def test_what_does_not_fit_is_refused_by_name(path, change, message):
    rewrite(path, change)
    with pytest.raises(WeightsError, match=rf"net\.safetensors: .*{message}"):
        load_weights(path)


def test_a_file_written_again_unchanged_is_accepted(path):
    rewrite(path, lambda tensors, texts: None)
    assert load_weights(path)[1] == METADATA


def test_the_metadata_can_be_read_without_this_program(path):
    with safe_open(path, framework="pt") as file:
        texts = file.metadata()
    assert json.loads(texts["architecture"]) == asdict(SMALL)
    assert json.loads(texts["training"]) == METADATA.training


def test_a_refusal_is_an_error_of_descriptors(tmp_path):
    with pytest.raises(DescriptorError):
        load_weights(tmp_path)
