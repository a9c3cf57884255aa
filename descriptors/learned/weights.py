"""Files of trained weights: tensors as safetensors, and in the metadata all it takes to use and to judge them.

They are read by numpy alone, so that a replay needs no torch.
"""

import os
from collections.abc import Mapping
from pathlib import Path
from typing import Any, Literal, TypeVar

import numpy as np
from pydantic import BaseModel, ConfigDict, Field, ValidationError

from descriptors.errors import WeightsError

_KEY = "dslam"
"""The only one in the metadata, for the library leaves the order of several to chance."""
_T = TypeVar("_T")


class Weights(BaseModel):
    """Tensors by their names, and where they come from.

    ``architecture``: the fields of the network's architecture; ``training``: the configuration of the training,
    ``metrics``: what it achieved.
    """

    model_config = ConfigDict(frozen=True, extra="forbid", arbitrary_types_allowed=True)

    tensors: dict[str, Any] = Field(default_factory=dict, exclude=True)
    architecture: dict[str, Any]
    training: dict[str, Any] = Field(default_factory=dict)
    seed: int = 0
    code_version: str = ""
    metrics: dict[str, Any] = Field(default_factory=dict)
    format_version: Literal[2] = 2


def save_weights(path: Path, weights: Weights) -> None:
    """Write a file of weights; equal weights give equal bytes.

    Raises:
        WeightsError: the file cannot be written.
    """
    from safetensors.numpy import save

    tensors = {name: np.asarray(tensor, order="C") for name, tensor in weights.tensors.items()}
    write_file(path, save(tensors, metadata={_KEY: weights.model_dump_json()}))


def write_file(path: Path, content: bytes) -> None:
    """Write NAME.part, which is renamed when it is complete.

    Raises:
        WeightsError: the file cannot be written.
    """
    part = path.with_name(path.name + ".part")
    try:
        part.write_bytes(content)
        os.replace(part, path)
    except OSError as error:
        raise WeightsError(f"{path}: cannot be written: {error.strerror}") from error


def read_weights(path: Path) -> Weights:
    """The weights of a file.

    Raises:
        WeightsError: no such file, or one that is truncated or of another format.
    """
    from safetensors import SafetensorError, safe_open

    try:
        with safe_open(path, framework="np") as file:
            tensors = {name: file.get_tensor(name) for name in file.keys()}  # noqa: SIM118
            text = (file.metadata() or {}).get(_KEY, "")
        return Weights.model_validate_json(text).model_copy(update={"tensors": tensors})
    except (SafetensorError, OSError, TypeError) as error:
        raise WeightsError(f"{path}: cannot be read as weights: {error}; download or train them again") from error
    except ValidationError as error:
        raise WeightsError(f"{path}: weights of another format: {_first(error)}; train again") from error


def make_architecture(path: Path, kind: type[_T], values: Mapping[str, object]) -> _T:
    """The architecture, a dataclass of pydantic, with these fields.

    Raises:
        WeightsError: fields that are unknown or of the wrong type.
    """
    try:
        return kind(**values)
    except ValidationError as error:
        raise WeightsError(f"{path}: architecture {values.get('name')!r}: {_first(error)}") from error


def _first(error: ValidationError) -> str:
    first = error.errors()[0]
    return f"{'.'.join(map(str, first['loc']))}: {first['msg']}"
