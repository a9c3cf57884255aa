"""Files of trained weights: tensors as safetensors, and in the metadata all it takes to use and to judge them.

They are read by numpy alone, so that a replay needs no torch.
"""

from __future__ import annotations

import hashlib
import json
import os
from collections.abc import Mapping
from dataclasses import dataclass, field, fields
from pathlib import Path
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from descriptors.errors import DescriptorError, WeightsError

FORMAT_VERSION = "1"
_T = TypeVar("_T")


@dataclass(frozen=True, slots=True, eq=False)
class Weights:
    """Tensors by their names, and where they come from.

    ``architecture``: the fields of the network's architecture; ``training``: the configuration of the training,
    ``metrics``: what it achieved, all as JSON holds them.
    """

    tensors: Mapping[str, NDArray[Any]]
    architecture: Mapping[str, Any]
    training: Mapping[str, Any] = field(default_factory=dict)
    seed: int = 0
    code_version: str = ""
    metrics: Mapping[str, Any] = field(default_factory=dict)


def save_weights(path: Path, weights: Weights) -> None:
    """Write a file of weights; equal weights give equal bytes.

    Raises:
        WeightsError: the file cannot be written, or the metadata are no JSON.
    """
    from safetensors.numpy import save

    tensors = {name: np.asarray(tensor, order="C") for name, tensor in weights.tensors.items()}
    try:
        texts = {name: json.dumps(getattr(weights, name), allow_nan=False, sort_keys=True) for name in _texts()}
    except (TypeError, ValueError) as error:
        raise WeightsError(f"{path}: the metadata cannot be written as JSON: {error}") from error
    texts |= {"format_version": FORMAT_VERSION, "sha256": _digest(tensors)}
    part = path.with_name(path.name + ".part")
    try:
        part.write_bytes(_with_sorted_header(save(tensors, metadata=texts)))
        os.replace(part, path)
    except OSError as error:
        raise WeightsError(f"{path}: cannot be written: {error.strerror}") from error


def read_weights(path: Path) -> Weights:
    """The weights of a file.

    Raises:
        WeightsError: no such file, or one that is truncated, altered or of another format.
    """
    tensors, texts = _read(path)
    version = texts.get("format_version")
    if version != FORMAT_VERSION:
        raise WeightsError(
            f"{path}: format version {version!r}, this program reads {FORMAT_VERSION!r}; train again, or use the "
            "program that wrote the file"
        )
    digest = _digest(tensors)
    if digest != texts.get("sha256"):
        raise WeightsError(
            f"{path}: the tensors have SHA-256 {digest}, the file says {texts.get('sha256')}; it was altered, "
            "get it again"
        )
    return Weights(
        tensors,
        _typed(path, texts, "architecture", dict),
        _typed(path, texts, "training", dict),
        _typed(path, texts, "seed", int),
        _typed(path, texts, "code_version", str),
        _typed(path, texts, "metrics", dict),
    )


def make_architecture(kind: type[_T], values: Mapping[str, object]) -> _T:
    """The architecture, a dataclass, with exactly these fields.

    Raises:
        DescriptorError: fields that are unknown, missing or of the wrong type.
    """
    from pydantic import TypeAdapter, ValidationError

    name = values.get("name")
    known = {each.name for each in fields(kind)}  # type: ignore[arg-type]
    unknown, missing = sorted(set(values) - known), sorted(known - set(values))
    if unknown or missing:
        problem = f"unknown fields {unknown}" if unknown else f"no fields {missing}"
        raise DescriptorError(f"architecture {name!r} with {problem}; it has {sorted(known)}")
    try:
        return TypeAdapter(kind).validate_json(json.dumps(values), strict=True)
    except ValidationError as error:
        first = error.errors()[0]
        raise DescriptorError(
            f"architecture {name!r} with {first['loc'][0]} = {first['input']!r}: {first['msg']}"
        ) from error


def check_tensors(path: Path, weights: Weights, expected: Mapping[str, tuple[tuple[int, ...], str]]) -> None:
    """Refuse weights whose tensors do not have the ``expected`` shapes and types.

    Raises:
        WeightsError: a tensor too many or too few, or one of another shape or type.
    """
    found = {name: (tensor.shape, str(tensor.dtype)) for name, tensor in weights.tensors.items()}
    for name in sorted({*found, *expected}):
        if name not in expected:
            raise WeightsError(f"{path}: tensor {name} of shape {found[name][0]} has no place in the architecture")
        shape, kind = expected[name]
        if name not in found:
            raise WeightsError(f"{path}: no tensor {name}, of which the architecture needs shape {shape}")
        if found[name] != (shape, kind):
            raise WeightsError(
                f"{path}: tensor {name} is {found[name][1]} of shape {found[name][0]}, the architecture needs "
                f"{kind} of shape {shape}"
            )


def _texts() -> list[str]:
    """What is kept as JSON."""
    return [each.name for each in fields(Weights) if each.name != "tensors"]


def _read(path: Path) -> tuple[dict[str, NDArray[Any]], dict[str, str]]:
    from safetensors import SafetensorError, safe_open

    if not path.is_file():
        raise WeightsError(f"{path}: no such file")
    try:
        with safe_open(path, framework="np") as file:
            tensors = {name: file.get_tensor(name) for name in file.keys()}  # noqa: SIM118
            return tensors, dict(file.metadata() or {})
    except (SafetensorError, OSError, TypeError) as error:
        raise WeightsError(f"{path}: truncated, or not a safetensors file: {error}; get it again") from error


def _typed(path: Path, texts: Mapping[str, str], key: str, kind: type[_T]) -> _T:
    try:
        value = json.loads(texts[key])
    except (KeyError, ValueError, RecursionError) as error:
        raise WeightsError(
            f"{path}: metadata without a readable {key!r}; these are not weights of this program"
        ) from error
    if not isinstance(value, kind):
        raise WeightsError(f"{path}: {key!r} in the metadata is {value!r}, which is not a {kind.__name__}")
    return value


def _digest(tensors: Mapping[str, NDArray[Any]]) -> str:
    digest = hashlib.sha256()
    for name in sorted(tensors):
        tensor = tensors[name]
        digest.update(f"{name} torch.{tensor.dtype} {tensor.shape}\n".encode())
        digest.update(tensor.tobytes())
    return digest.hexdigest()


def _with_sorted_header(content: bytes) -> bytes:
    """The same safetensors file with its metadata in order; the library leaves that to chance."""
    size = int.from_bytes(content[:8], "little")
    header = json.loads(content[8 : 8 + size])
    header["__metadata__"] = dict(sorted(header["__metadata__"].items()))
    text = json.dumps(header, separators=(",", ":")).encode()
    text += b" " * (-len(text) % 8)
    return len(text).to_bytes(8, "little") + text + content[8 + size :]
