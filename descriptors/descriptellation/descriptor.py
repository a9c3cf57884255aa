"""The paper's network as a descriptor: its weights, and how it describes constellations."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import torch
from torch import Tensor

from descriptors.arrays import Float32Array
from descriptors.constellation import Constellations
from descriptors.descriptellation.network import Descriptellation, DescriptellationArchitecture
from descriptors.errors import DescriptorError, WeightsError
from descriptors.weight_file import make_architecture, read_weights

BATCH = 256
"""Constellations that are described at a time."""


class NetworkDescriptor:
    """The network with its weights; the radius is the one it was trained with.

    A class enters as the row of the embedding that has its place in the vocabulary. Rows mean nothing of their own,
    since the network was trained on classes that were dealt out anew in every map.
    """

    def __init__(self, path: Path) -> None:
        """Load a weights file.

        Raises:
            WeightsError: the file is missing, damaged or at odds with its architecture.
        """
        self._network = load_network(path)
        architecture = self._network.architecture
        self.name, self.length, self.radius_m = architecture.name, architecture.length, architecture.radius_m
        self.vocabulary_size = architecture.vocabulary_size

    def describe(self, constellations: Constellations) -> Float32Array:
        """Vectors (B, length).

        Raises:
            DescriptorError: more classes than the embedding has rows.
        """
        labels = np.concatenate([constellations.labels, constellations.centre_labels])
        if labels.min(initial=0) < 0 or labels.max(initial=0) >= self.vocabulary_size:
            raise DescriptorError(
                f"labels {labels.min()} to {labels.max()} in a network for {self.vocabulary_size} classes: merge rare "
                "classes of the vocabulary"
            )
        described = np.zeros((len(constellations), self.length), dtype=np.float32)
        # Batches of about equal size need little padding.
        order = np.argsort(np.diff(constellations.offsets), kind="stable")
        threads = torch.get_num_threads()
        torch.set_num_threads(1)  # sums over threads would differ from machine to machine
        try:
            with torch.no_grad():
                for start in range(0, len(order), BATCH):
                    rows = order[start : start + BATCH]
                    described[rows] = self._network(*pad_constellations(constellations[rows])).numpy()
        finally:
            torch.set_num_threads(threads)
        return described


def load_network(path: Path) -> Descriptellation:
    """The network of a file in evaluation mode; torch's generator is left alone.

    Raises:
        WeightsError: no such file, or one that is damaged or at odds with its architecture.
    """
    weights = read_weights(path)
    tensors = {name: torch.from_numpy(tensor.copy()) for name, tensor in weights.tensors.items()}
    architecture = make_architecture(path, DescriptellationArchitecture, weights.architecture)
    try:
        with torch.device("meta"):  # neither memory nor random numbers for weights to be replaced
            network = Descriptellation(architecture)
        network.to_empty(device="cpu").load_state_dict(tensors)
    except RuntimeError as error:
        raise WeightsError(f"{path}: {' '.join(str(error).split())}") from error
    return network.eval()


def pad_constellations(constellations: Constellations) -> tuple[Tensor, Tensor, Tensor]:
    """Positions (B, N, 3) float32 m, labels (B, N) and presence (B, N) of the objects, the centre first.

    Positions are relative to the centre. Positions and labels are 0 where no object is.
    """
    counts = np.diff(constellations.offsets)
    shape = (len(constellations), int(counts.max(initial=0)) + 1)
    positions = np.zeros((*shape, 3), dtype=np.float32)
    labels = np.zeros(shape, dtype=np.int64)
    places = np.arange(shape[1])
    present = places <= counts[:, None]
    others = present & (places > 0)
    positions[others] = constellations.positions
    labels[others] = constellations.labels
    labels[:, 0] = constellations.centre_labels
    return torch.from_numpy(positions), torch.from_numpy(labels), torch.from_numpy(present)
