"""Batches of padded constellations as tensors."""

import torch
from torch import Tensor

Batch = tuple[Tensor, Tensor, Tensor]


def batch(counts: tuple[int, ...], room: int, *, seed: int = 0) -> Batch:
    """Constellations of so many objects each within 30 m, padded to ``room`` objects."""
    generator = torch.Generator().manual_seed(seed)
    present = torch.arange(room) < torch.tensor(counts)[:, None]
    positions = torch.zeros(len(counts), room, 3)
    labels = torch.zeros(len(counts), room, dtype=torch.int64)
    for row, count in enumerate(counts):  # drawn one by one, so that they do not depend on the room
        positions[row, 1:count] = torch.rand(count - 1, 3, generator=generator) * 60.0 - 30.0
        labels[row, :count] = torch.randint(0, 64, (count,), generator=generator)
    return positions, labels, present
