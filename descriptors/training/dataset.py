"""Constellations of simulated maps with several noisy observations of each, to train and to validate on.

Xing et al., Descriptellation: Deep Learned Constellation Descriptors, Section III-E.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from descriptors.constellation import gather_constellations
from descriptors.learned.padded import PaddedConstellations, pad_constellations
from descriptors.training.augmentation import AugmentationRates, augment
from descriptors.training.simulation import MapSimulation, simulate_map


@dataclass(frozen=True, slots=True)
class DatasetConfig:
    """Sizes of a dataset; ``anchors`` and ``positives`` for each of them are the paper's, as is ``radius_m``.

    The paper takes the anchors from a series of maps and does not say how many from each; ``anchors_per_map`` is ours.
    So are ``min_objects`` and ``max_objects`` of an anchor, the centre counted: constellations outside are passed over.
    A positive may have fewer or more.
    """

    anchors: int = 1000
    positives: int = 9
    radius_m: float = 30.0
    anchors_per_map: int = 10
    min_objects: int = 5
    max_objects: int = 40


@dataclass(frozen=True, slots=True, eq=False)
class ConstellationDataset:
    """B = anchors (1 + positives) constellations; those with one number in ``anchors`` (B,) show the same place.

    They are next to each other: the anchor as it is, then its positives.
    """

    constellations: PaddedConstellations
    anchors: NDArray[np.int64]


def make_dataset(
    simulation: MapSimulation, rates: AugmentationRates, config: DatasetConfig, *, seed: int
) -> ConstellationDataset:
    """Anchors of simulated maps with their positives, the same for the same ``seed``.

    The paper's randomly sampled viewpoints are the random headings among the augmentations.
    """
    rng = np.random.default_rng(seed)
    anchors = simulate_anchors(simulation, config, rng=rng)
    numbers = np.arange(config.anchors)
    positives = augment(anchors[np.repeat(numbers, config.positives)], rates, rng=rng)
    owners = np.concatenate([numbers, np.repeat(numbers, config.positives)])
    order = np.argsort(owners, kind="stable")
    return ConstellationDataset(_stack([anchors, positives])[order], owners[order])


def simulate_anchors(
    simulation: MapSimulation, config: DatasetConfig, *, rng: np.random.Generator
) -> PaddedConstellations:
    """``config.anchors`` constellations of objects of simulated maps, as they are."""
    gathered: list[PaddedConstellations] = []
    missing = config.anchors
    vocabulary = [str(number) for number in range(simulation.vocabulary_size)]
    while missing:
        drawn = simulate_map(simulation, rng=rng)
        found = gather_constellations(drawn.positions, drawn.labels, vocabulary, radius_m=config.radius_m)
        sizes = np.diff(found.offsets) + 1
        fitting = rng.permutation(np.flatnonzero((sizes >= config.min_objects) & (sizes <= config.max_objects)))
        chosen = fitting[: min(missing, config.anchors_per_map)]
        missing -= len(chosen)
        gathered.append(pad_constellations(found[chosen]))
    return _stack(gathered)


def _stack(batches: Sequence[PaddedConstellations]) -> PaddedConstellations:
    """All constellations of the batches in one, with the room of the largest."""
    room = max(batch.present.shape[1] for batch in batches)
    paddings = [((0, 0), (0, room - batch.present.shape[1])) for batch in batches]
    each = list(zip(batches, paddings, strict=True))
    return PaddedConstellations(
        np.concatenate([np.pad(batch.positions, (*padding, (0, 0))) for batch, padding in each]),
        np.concatenate([np.pad(batch.labels, padding) for batch, padding in each]),
        np.concatenate([np.pad(batch.present, padding) for batch, padding in each]),
    )
