"""A descriptor made by a trained network."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import torch

from descriptors.arrays import Float32Array
from descriptors.constellation import Constellations
from descriptors.errors import DescriptorError
from descriptors.learned.networks import architecture_of, describe_by_network, load_network


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
        self._network, _ = load_network(path)
        architecture = architecture_of(self._network)
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
                "classes of the vocabulary, or train with a larger vocabulary_size"
            )
        threads = torch.get_num_threads()
        torch.set_num_threads(1)  # sums over threads would differ from machine to machine
        try:
            return describe_by_network(self._network, constellations)
        finally:
            torch.set_num_threads(threads)
