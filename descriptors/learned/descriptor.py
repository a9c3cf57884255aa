"""A descriptor made by a trained network."""

from pathlib import Path

import numpy as np
import torch

from descriptors.arrays import Float32Array
from descriptors.constellation import Constellations
from descriptors.errors import DescriptorError
from descriptors.learned.networks import VectorArchitecture, load_network, vectors_of

BATCH = 256
"""Constellations that are described at a time."""


class LearnedDescriptor:
    """A network with its weights; the radius is the one it was trained with.

    A class enters as the row of the embedding that has its place in the vocabulary. Rows mean nothing of their own,
    since the network was trained on classes that were dealt out anew in every map.
    """

    def __init__(self, path: Path) -> None:
        """Load a weights file.

        Raises:
            WeightsError: the file is missing, damaged or at odds with its architecture.
        """
        self._network = load_network(path)
        self._architecture: VectorArchitecture = self._network.architecture  # type: ignore[assignment]
        self.name, self.radius_m = self._architecture.name, self._architecture.radius_m

    def describe(self, constellations: Constellations) -> Float32Array:
        """Vectors (B, length).

        Raises:
            DescriptorError: more classes than the embedding has rows.
        """
        labels = np.concatenate([constellations.labels, constellations.centre_labels])
        if labels.max(initial=0) >= self._architecture.vocabulary_size:
            raise DescriptorError(
                f"labels {labels.min()} to {labels.max()} in a network for {self._architecture.vocabulary_size} "
                "classes: merge rare classes of the vocabulary, or train with a larger vocabulary_size"
            )
        described = np.zeros((len(constellations), self._architecture.length), dtype=np.float32)
        # Batches of about equal size need little padding.
        order = np.argsort(np.diff(constellations.offsets), kind="stable")
        threads = torch.get_num_threads()
        torch.set_num_threads(1)  # sums over threads would differ from machine to machine
        try:
            with torch.no_grad():
                for start in range(0, len(order), BATCH):
                    rows = order[start : start + BATCH]
                    described[rows] = vectors_of(self._network, constellations[rows], torch.device("cpu")).numpy()
        finally:
            torch.set_num_threads(threads)
        return described
