"""The networks there are, by name, and how one is built.

A new one: a frozen dataclass with ``name``, ``vocabulary_size`` and ``length`` and with defaults that JSON can hold, a
module that takes it and keeps it as ``architecture``, and their line in ``ARCHITECTURES``.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import asdict, fields
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray
from pydantic import TypeAdapter, ValidationError
from torch import nn

from descriptors.baselines.pointnet import PointNet, PointNetArchitecture
from descriptors.baselines.sgnet import SGNet, SGNetArchitecture
from descriptors.descriptellation.network import Descriptellation, DescriptellationArchitecture
from descriptors.errors import DescriptorError


class Architecture(Protocol):
    """What all architectures say of their network."""

    @property
    def name(self) -> str:
        """Its name in the registry."""
        ...

    @property
    def vocabulary_size(self) -> int:
        """How many classes it can tell apart."""
        ...

    @property
    def length(self) -> int:
        """How many numbers a descriptor has."""
        ...


ARCHITECTURES: dict[str, tuple[type[Any], type[nn.Module]]] = {
    "descriptellation": (DescriptellationArchitecture, Descriptellation),
    "pointnet": (PointNetArchitecture, PointNet),
    "sgnet": (SGNetArchitecture, SGNet),
}


def make_architecture(values: Mapping[str, object]) -> Architecture:
    """The architecture with exactly these fields, ``name`` among them.

    Raises:
        DescriptorError: a name that does not exist, or fields that are unknown, missing or of the wrong type.
    """
    name = values.get("name")
    if not isinstance(name, str) or name not in ARCHITECTURES:
        raise DescriptorError(f"no architecture {name!r}; there are {', '.join(ARCHITECTURES)}")
    kind = ARCHITECTURES[name][0]
    known = {field.name for field in fields(kind)}
    unknown, missing = sorted(set(values) - known), sorted(known - set(values))
    if unknown or missing:
        problem = f"unknown fields {unknown}" if unknown else f"no fields {missing}"
        raise DescriptorError(f"architecture {name!r} with {problem}; it has {sorted(known)}")
    try:
        made: Architecture = TypeAdapter(kind).validate_json(json.dumps(values), strict=True)
    except ValidationError as error:
        first = error.errors()[0]
        raise DescriptorError(
            f"architecture {name!r} with {first['loc'][0]} = {first['input']!r}: {first['msg']}"
        ) from error
    return made


def default_architecture(name: str, **settings: object) -> Architecture:
    """The architecture of that name with its default sizes, ``settings`` changed.

    Raises:
        DescriptorError: a name that does not exist, or settings that are unknown or of the wrong type.
    """
    if name not in ARCHITECTURES:
        raise DescriptorError(f"no architecture {name!r}; there are {', '.join(ARCHITECTURES)}")
    return make_architecture({**asdict(ARCHITECTURES[name][0]()), **settings})


def make_network(architecture: Architecture) -> nn.Module:
    """The network of that architecture, with random weights from torch's generator.

    Raises:
        DescriptorError: an architecture that is not registered.
    """
    if architecture.name not in ARCHITECTURES:
        raise DescriptorError(f"no architecture {architecture.name!r}; there are {', '.join(ARCHITECTURES)}")
    return ARCHITECTURES[architecture.name][1](architecture)


def check_labels(labels: NDArray[np.int64], vocabulary_size: int) -> None:
    """Refuse labels that a network has no row for.

    Raises:
        DescriptorError: a label below 0, or not below ``vocabulary_size``.
    """
    if labels.size == 0:
        return
    lowest, highest = int(labels.min()), int(labels.max())
    if lowest < 0:
        raise DescriptorError(f"label {lowest} is no place in a vocabulary of {vocabulary_size} classes")
    if highest >= vocabulary_size:
        raise DescriptorError(
            f"label {highest} in a network for {vocabulary_size} classes, 0 to {vocabulary_size - 1}: "
            "merge rare classes of the vocabulary, or train with a larger vocabulary_size"
        )
