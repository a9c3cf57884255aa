"""Noise that makes another observation of the same constellation.

Xing et al., Descriptellation: Deep Learned Constellation Descriptors, Section III-E. Each function takes a batch whose
centres are first and at the origin, leaves the centres as they are, and returns a new batch without holes. ``|p|`` is
the length in three dimensions.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from descriptors.errors import DescriptorError
from descriptors.learned.padded import PaddedConstellations


@dataclass(frozen=True, slots=True)
class Normal:
    """Normal distribution of mean 0 and standard deviation ``sigma``."""

    sigma: float
    kind: Literal["normal"] = "normal"

    def draw(self, shape: tuple[int, ...], *, rng: np.random.Generator) -> NDArray[np.float64]:
        """Independent numbers of ``shape``."""
        return rng.normal(scale=self.sigma, size=shape)


@dataclass(frozen=True, slots=True)
class Uniform:
    """Uniform distribution from ``low`` to ``high``."""

    low: float
    high: float
    kind: Literal["uniform"] = "uniform"

    def draw(self, shape: tuple[int, ...], *, rng: np.random.Generator) -> NDArray[np.float64]:
        """Independent numbers of ``shape``."""
        return rng.uniform(self.low, self.high, size=shape)


Distribution = Normal | Uniform


@dataclass(frozen=True, slots=True)
class AugmentationRates:
    """How strong each augmentation is; the paper's values, ``vocabulary_size`` aside.

    The 0.25 of the paper's N(0, 0.25) is read as a deviation: as a variance it would move objects by half their
    distance, along each axis. ``dropout``, ``false_positives`` and ``misclassification`` are probabilities.

    Raises:
        DescriptorError: a probability that is none, or a vocabulary with no two classes to confuse.
    """

    translation: Distribution = Normal(0.25)
    yaw_rad: Distribution = Uniform(-np.pi, np.pi)
    dropout: float = 0.1
    false_positives: float = 0.1
    misclassification: float = 0.1
    crop: Distribution = Uniform(0.0, 0.3)
    scale: Distribution = Uniform(0.85, 1.25)
    vocabulary_size: int = 64

    def __post_init__(self) -> None:
        for name in ("dropout", "false_positives", "misclassification"):
            if not 0.0 <= getattr(self, name) <= 1.0:
                raise DescriptorError(f"{name} is {getattr(self, name)}; give a probability, 0 to 1")
        if self.vocabulary_size < 2:
            raise DescriptorError(f"vocabulary_size is {self.vocabulary_size}; misclassifying takes at least 2 classes")


def augment(batch: PaddedConstellations, rates: AugmentationRates, *, rng: np.random.Generator) -> PaddedConstellations:
    """All seven, in the order in which the paper lists them: so crops come from any side and hit false positives too.

    Raises:
        DescriptorError: labels that ``rates.vocabulary_size`` does not cover.
    """
    translated = translate(batch, rates.translation, rng=rng)
    oriented = orient(translated, rates.yaw_rad, rng=rng)
    thinned = drop_out(oriented, rates.dropout, rng=rng)
    filled = add_false_positives(thinned, rates.false_positives, rates.vocabulary_size, rng=rng)
    confused = misclassify(filled, rates.misclassification, rates.vocabulary_size, rng=rng)
    cropped = crop(confused, rates.crop, rng=rng)
    return scale(cropped, rates.scale, rng=rng)


def translate(batch: PaddedConstellations, errors: Distribution, *, rng: np.random.Generator) -> PaddedConstellations:
    """Trans: ``p_i + |p_i| e``, with ``e`` drawn for each object and axis."""
    lengths_m = _lengths(batch)[:, :, None]
    positions = batch.positions + lengths_m * errors.draw(batch.positions.shape, rng=rng)
    return PaddedConstellations(positions.astype(np.float32), batch.labels, batch.present)


def orient(batch: PaddedConstellations, yaw_rad: Distribution, *, rng: np.random.Generator) -> PaddedConstellations:
    """Orient: ``R_z(r) p_i``, with one angle ``r`` for each constellation; heights stay, gravity being known."""
    angles = yaw_rad.draw((len(batch), 1), rng=rng)
    x, y, z = np.moveaxis(batch.positions.astype(np.float64), 2, 0)
    turned = np.stack([np.cos(angles) * x - np.sin(angles) * y, np.sin(angles) * x + np.cos(angles) * y, z], axis=2)
    return PaddedConstellations(turned.astype(np.float32), batch.labels, batch.present)


def drop_out(batch: PaddedConstellations, probability: float, *, rng: np.random.Generator) -> PaddedConstellations:
    """Dropout: each object but the centre is missed with ``probability``."""
    return _keep(batch, rng.random(batch.present.shape) >= probability)


def add_false_positives(
    batch: PaddedConstellations, probability: float, vocabulary_size: int, *, rng: np.random.Generator
) -> PaddedConstellations:
    """FP: each object, the centre too, gives rise to another one with ``probability``.

    The paper says no more than a random object. Ours is anywhere within the horizontal distance of the farthest object,
    equally likely per area, as high as the object that gave rise to it, and of any class of the vocabulary.

    Raises:
        DescriptorError: labels that ``vocabulary_size`` does not cover.
    """
    _check_labels(batch, vocabulary_size)
    shape = batch.present.shape
    plan = batch.positions[:, :, :2].astype(np.float64)
    radii_m = np.linalg.norm(plan, axis=2).max(axis=1, initial=0.0)[:, None] * np.sqrt(rng.random(shape))
    angles = rng.uniform(-np.pi, np.pi, size=shape)
    added = np.stack([radii_m * np.cos(angles), radii_m * np.sin(angles), batch.positions[:, :, 2]], axis=2)
    return compact(
        PaddedConstellations(
            np.concatenate([batch.positions, added.astype(np.float32)], axis=1),
            np.concatenate([batch.labels, rng.integers(vocabulary_size, size=shape)], axis=1),
            np.concatenate([batch.present, batch.present & (rng.random(shape) < probability)], axis=1),
        )
    )


def misclassify(
    batch: PaddedConstellations, alpha: float, vocabulary_size: int, *, rng: np.random.Generator
) -> PaddedConstellations:
    """Misclass: an object gets any other class with probability ``|p_i| / max_j |p_j| * alpha``.

    Raises:
        DescriptorError: labels that ``vocabulary_size`` does not cover.
    """
    _check_labels(batch, vocabulary_size)
    lengths_m = _lengths(batch)
    farthest_m = lengths_m.max(axis=1, keepdims=True, initial=0.0)
    # Compared without the division, which a centre on its own does not allow.
    confused = rng.random(lengths_m.shape) * farthest_m < lengths_m * alpha
    others = (batch.labels + rng.integers(1, vocabulary_size, size=lengths_m.shape)) % vocabulary_size
    return PaddedConstellations(batch.positions, np.where(confused, others, batch.labels), batch.present)


def crop(batch: PaddedConstellations, shares: Distribution, *, rng: np.random.Generator) -> PaddedConstellations:
    """Crop: objects go if ``p_i,xi > max_j |p_j| (1 - e)``, with one share ``e`` for each constellation.

    The axis ``xi`` is x or y with equal probability: no object lies that far up.
    """
    limits_m = _lengths(batch).max(axis=1, initial=0.0) * (1.0 - shares.draw((len(batch),), rng=rng))
    axes = rng.integers(2, size=len(batch))
    along = batch.positions[np.arange(len(batch)), :, axes].astype(np.float64)
    return _keep(batch, along <= limits_m[:, None])


def scale(batch: PaddedConstellations, factors: Distribution, *, rng: np.random.Generator) -> PaddedConstellations:
    """Scale: ``s p_i``, with one factor ``s`` for each constellation."""
    scaled = batch.positions * factors.draw((len(batch), 1, 1), rng=rng)
    return PaddedConstellations(scaled.astype(np.float32), batch.labels, batch.present)


def compact(batch: PaddedConstellations) -> PaddedConstellations:
    """The same objects in the same order, without holes between them and with no more room than they need."""
    order = np.argsort(~batch.present, axis=1, kind="stable")
    order = order[:, : int(batch.present.sum(axis=1).max(initial=1))]
    present = np.take_along_axis(batch.present, order, axis=1)
    positions = np.take_along_axis(batch.positions, order[:, :, None], axis=1)
    labels = np.take_along_axis(batch.labels, order, axis=1)
    return PaddedConstellations(
        np.where(present[:, :, None], positions, np.float32(0.0)), np.where(present, labels, 0), present
    )


def _keep(batch: PaddedConstellations, kept: NDArray[np.bool_]) -> PaddedConstellations:
    """The objects of ``kept`` (B, N), and the centres."""
    present = batch.present & kept
    present[:, :1] = True
    return compact(PaddedConstellations(batch.positions, batch.labels, present))


def _lengths(batch: PaddedConstellations) -> NDArray[np.float64]:
    """Distances (B, N) m from the centre, 0 where nothing is."""
    return np.asarray(np.linalg.norm(batch.positions.astype(np.float64), axis=2))


def _check_labels(batch: PaddedConstellations, vocabulary_size: int) -> None:
    if vocabulary_size < 2 or batch.labels.max(initial=0) >= vocabulary_size:
        raise DescriptorError(
            f"labels up to {batch.labels.max(initial=0)} and a vocabulary of {vocabulary_size} classes; "
            "give the size of the vocabulary that the labels are from, at least 2"
        )
