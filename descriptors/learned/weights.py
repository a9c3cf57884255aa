"""Files of trained weights: tensors as safetensors, and in the metadata all it takes to use and to judge them."""

from __future__ import annotations

import hashlib
import json
import os
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any, TypeVar

import torch
from safetensors import SafetensorError, safe_open
from safetensors.torch import save
from torch import Tensor, nn

from descriptors.errors import DescriptorError, WeightsError
from descriptors.learned.architectures import make_architecture, make_network

FORMAT_VERSION = "1"
_T = TypeVar("_T")


@dataclass(frozen=True, slots=True)
class WeightsMetadata:
    """Where weights come from; the architecture is the network's own.

    ``training``: the configuration of the training, ``metrics``: what it achieved, both as JSON holds them.
    """

    training: Mapping[str, Any] = field(default_factory=dict)
    seed: int = 0
    code_version: str = ""
    metrics: Mapping[str, Any] = field(default_factory=dict)


def save_weights(path: Path, network: nn.Module, metadata: WeightsMetadata) -> None:
    """Write the network's weights; equal weights and metadata give equal bytes.

    Args:
        network: one of ``descriptors.learned.architectures``.

    Raises:
        WeightsError: the file cannot be written, or the metadata are no JSON.
    """
    tensors = {name: tensor.detach().cpu().contiguous() for name, tensor in network.state_dict().items()}
    try:
        texts = {
            "format_version": FORMAT_VERSION,
            "architecture": _json(asdict(network.architecture)),  # type: ignore[call-overload]
            "training": _json(metadata.training),
            "seed": _json(metadata.seed),
            "code_version": _json(metadata.code_version),
            "metrics": _json(metadata.metrics),
            "sha256": _digest(tensors),
        }
    except (TypeError, ValueError) as error:
        raise WeightsError(f"{path}: the metadata cannot be written as JSON: {error}") from error
    part = path.with_name(path.name + ".part")
    try:
        part.write_bytes(with_sorted_header(save(tensors, metadata=texts)))
        os.replace(part, path)
    except OSError as error:
        raise WeightsError(f"{path}: cannot be written: {error.strerror}") from error


def load_weights(path: Path) -> tuple[nn.Module, WeightsMetadata]:
    """The network in evaluation mode with its weights, and where they come from; torch's generator is left alone.

    Raises:
        WeightsError: no such file, or one that is truncated, altered, of another format or at odds with its
            architecture.
    """
    tensors, texts = _read(path)
    version = texts.get("format_version")
    if version != FORMAT_VERSION:
        raise WeightsError(
            f"{path}: format version {version!r}, this program reads {FORMAT_VERSION!r}; train again, or use the "
            "program that wrote the file"
        )
    try:
        architecture = make_architecture(_mapping(path, texts, "architecture"))
    except DescriptorError as error:
        raise error if isinstance(error, WeightsError) else WeightsError(f"{path}: {error}") from error
    with torch.device("meta"):  # shapes alone: neither memory nor random numbers for weights to be replaced
        network = make_network(architecture)
    _check_shapes(path, tensors, network.state_dict())
    digest = _digest(tensors)
    if digest != texts.get("sha256"):
        raise WeightsError(
            f"{path}: the tensors have SHA-256 {digest}, the file says {texts.get('sha256')}; it was altered, "
            "get it again"
        )
    network.load_state_dict(tensors, assign=True)
    metadata = WeightsMetadata(
        training=_mapping(path, texts, "training"),
        seed=_typed(path, texts, "seed", int),
        code_version=_typed(path, texts, "code_version", str),
        metrics=_mapping(path, texts, "metrics"),
    )
    return network.eval(), metadata


def _read(path: Path) -> tuple[dict[str, Tensor], dict[str, str]]:
    if not path.is_file():
        raise WeightsError(f"{path}: no such file")
    try:
        with safe_open(path, framework="pt") as file:
            # Cloned, as the tensors otherwise lie in the file, whoever changes it later.
            tensors = {name: file.get_tensor(name).clone() for name in file.keys()}  # noqa: SIM118
            return tensors, dict(file.metadata() or {})
    except (SafetensorError, OSError) as error:
        raise WeightsError(f"{path}: truncated, or no safetensors file: {error}; get it again") from error


def _check_shapes(path: Path, tensors: Mapping[str, Tensor], expected: Mapping[str, Tensor]) -> None:
    for name in sorted({*tensors, *expected}):
        found = tuple(tensors[name].shape) if name in tensors else None
        fits = tuple(expected[name].shape) if name in expected else None
        if fits is None:
            raise WeightsError(f"{path}: tensor {name} of shape {found} has no place in the architecture")
        if found is None:
            raise WeightsError(f"{path}: no tensor {name}, of which the architecture needs shape {fits}")
        if found != fits or tensors[name].dtype != expected[name].dtype:
            raise WeightsError(
                f"{path}: tensor {name} is {tensors[name].dtype} of shape {found}, the architecture needs "
                f"{expected[name].dtype} of shape {fits}"
            )


def _mapping(path: Path, texts: Mapping[str, str], key: str) -> dict[str, Any]:
    return _typed(path, texts, key, dict)


def _typed(path: Path, texts: Mapping[str, str], key: str, kind: type[_T]) -> _T:
    try:
        value = json.loads(texts[key])
    except (KeyError, ValueError, RecursionError) as error:
        raise WeightsError(
            f"{path}: metadata without a readable {key!r}; these are no weights of this program"
        ) from error
    if not isinstance(value, kind):
        raise WeightsError(f"{path}: {key!r} in the metadata is {value!r}, which is no {kind.__name__}")
    return value


def _json(value: object) -> str:
    return json.dumps(dict(value) if isinstance(value, Mapping) else value, allow_nan=False, sort_keys=True)


def _digest(tensors: Mapping[str, Tensor]) -> str:
    digest = hashlib.sha256()
    for name in sorted(tensors):
        tensor = tensors[name].contiguous()
        digest.update(f"{name} {tensor.dtype} {tuple(tensor.shape)}\n".encode())
        digest.update(tensor.reshape(-1).view(torch.uint8).numpy().tobytes())
    return digest.hexdigest()


def with_sorted_header(content: bytes) -> bytes:
    """The same safetensors file with its metadata in order; the library leaves that to chance."""
    size = int.from_bytes(content[:8], "little")
    header = json.loads(content[8 : 8 + size])
    header["__metadata__"] = dict(sorted(header["__metadata__"].items()))
    text = json.dumps(header, separators=(",", ":")).encode()
    text += b" " * (-len(text) % 8)
    return len(text).to_bytes(8, "little") + text + content[8 + size :]
