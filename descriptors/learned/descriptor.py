"""A descriptor made by a trained network."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import torch
from numpy.typing import NDArray

from descriptors.constellation import Constellations
from descriptors.descriptellation.network import Descriptellation
from descriptors.errors import DescriptorError, WeightsError
from descriptors.learned.networks import describe_padded, load_network
from descriptors.learned.padded import pad_constellations


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
        self._network, weights = load_network(path)
        self.name = str(self._network.architecture.name)  # type: ignore[union-attr]
        self.length = int(self._network.architecture.length)  # type: ignore[union-attr, arg-type]
        self.vocabulary_size = int(self._network.architecture.vocabulary_size)  # type: ignore[union-attr, arg-type]
        try:
            self.radius_m = float(weights.training["dataset"]["radius_m"])
        except (KeyError, TypeError, ValueError) as error:
            raise WeightsError(
                f"{path}: its training configuration has no dataset.radius_m, so its radius is unknown; train again"
            ) from error

    def set_edge_length(self, length_m: float) -> None:
        """Threshold of the graphs from now on; without effect on a network whose graphs have another rule."""
        if isinstance(self._network, Descriptellation):
            self._network.edge_length_m = length_m

    def describe(self, constellations: Constellations) -> NDArray[np.float32]:
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
            return describe_padded(self._network, pad_constellations(constellations), torch.device("cpu"))
        finally:
            torch.set_num_threads(threads)
