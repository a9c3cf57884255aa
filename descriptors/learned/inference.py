"""Descriptors by a network: many constellations in a few batches."""

from __future__ import annotations

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor, nn

from descriptors.learned.padded import PaddedConstellations

BATCH = 256


def tensors(constellations: PaddedConstellations, device: torch.device) -> tuple[Tensor, Tensor, Tensor]:
    """Positions, labels and presence as networks take them."""
    return (
        torch.as_tensor(constellations.positions, device=device),
        torch.as_tensor(constellations.labels, device=device),
        torch.as_tensor(constellations.present, device=device),
    )


def describe_padded(
    network: nn.Module, constellations: PaddedConstellations, device: torch.device
) -> NDArray[np.float32]:
    """Vectors (B, length) of a network in evaluation mode."""
    sizes = constellations.present.sum(axis=1)
    order = np.argsort(sizes, kind="stable")  # batches of about equal size need little padding
    described = [np.zeros((0, int(network.architecture.length)), dtype=np.float32)]  # type: ignore[union-attr, arg-type]
    with torch.no_grad():
        for start in range(0, len(order), BATCH):
            vectors = network(*tensors(constellations[order[start : start + BATCH]], device))
            described.append(vectors.cpu().numpy().astype(np.float32))
    ranks = np.empty_like(order)
    ranks[order] = np.arange(len(order))
    return np.asarray(np.concatenate(described)[ranks])
