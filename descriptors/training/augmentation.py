"""Noise that makes another observation of the same constellation.

Xing et al., Descriptellation: Deep Learned Constellation Descriptors, Section III-E. Each function takes a batch whose
centres are first and at the origin, leaves the centres as they are, and returns a new batch without holes. ``|p|`` is
the length in three dimensions.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from descriptors.learned.padded import PaddedConstellations

Range = tuple[float, float]


@dataclass(frozen=True, slots=True)
class AugmentationRates:
    """How strong each augmentation is; the paper's values, ``vocabulary_size`` aside.

    ``translation``: standard deviation, in lengths; the 0.25 of the paper's N(0, 0.25) as a variance would move objects
    by half their distance, along each axis. ``dropout``, ``false_positives`` and ``misclassification`` are
    probabilities; ``yaw_rad``, ``crop`` and ``scale`` are drawn uniformly between two bounds.
    """

    translation: float = 0.25
    yaw_rad: Range = (-np.pi, np.pi)
    dropout: float = 0.1
    false_positives: float = 0.1
    misclassification: float = 0.1
    crop: Range = (0.0, 0.3)
    scale: Range = (0.85, 1.25)
    vocabulary_size: int = 64


def augment(batch: PaddedConstellations, rates: AugmentationRates, *, rng: np.random.Generator) -> PaddedConstellations:
    """All seven, in the order in which the paper lists them: crops come from any side and hit false positives, too."""
    translated = translate(batch, rates.translation, rng=rng)
    oriented = orient(translated, rates.yaw_rad, rng=rng)
    thinned = drop_out(oriented, rates.dropout, rng=rng)
    filled = add_false_positives(thinned, rates.false_positives, rates.vocabulary_size, rng=rng)
    confused = misclassify(filled, rates.misclassification, rates.vocabulary_size, rng=rng)
    cropped = crop(confused, rates.crop, rng=rng)
    return scale(cropped, rates.scale, rng=rng)


def translate(batch: PaddedConstellations, sigma: float, *, rng: np.random.Generator) -> PaddedConstellations:
    """Trans: ``p_i + |p_i| e``, with ``e`` drawn for each object and axis."""
    errors = rng.normal(scale=sigma, size=batch.positions.shape)
    return _moved(batch, batch.positions + _lengths(batch)[:, :, None] * errors)


def orient(batch: PaddedConstellations, yaw_rad: Range, *, rng: np.random.Generator) -> PaddedConstellations:
    """Orient: ``R_z(r) p_i``, with one angle ``r`` for each constellation; heights stay, gravity being known."""
    turned = batch.positions.astype(np.float64)
    plane = turned[:, :, 0] + 1j * turned[:, :, 1]
    plane *= np.exp(1j * rng.uniform(*yaw_rad, (len(batch), 1)))
    turned[:, :, 0], turned[:, :, 1] = plane.real, plane.imag
    return _moved(batch, turned)


def drop_out(batch: PaddedConstellations, probability: float, *, rng: np.random.Generator) -> PaddedConstellations:
    """Dropout: each object but the centre is missed with ``probability``."""
    return _keep(batch, rng.random(batch.present.shape) >= probability)


def add_false_positives(
    batch: PaddedConstellations, probability: float, vocabulary_size: int, *, rng: np.random.Generator
) -> PaddedConstellations:
    """FP: each object, the centre too, gives rise to another one with ``probability``.

    The paper says no more than a random object. Ours is anywhere within the horizontal distance of the farthest object,
    equally likely per area, as high as the object that gave rise to it, and of any class of the vocabulary.
    """
    shape = batch.present.shape
    plan = batch.positions[:, :, :2].astype(np.float64)
    radii_m = np.linalg.norm(plan, axis=2).max(axis=1, initial=0.0)[:, None] * np.sqrt(rng.random(shape))
    angles = rng.uniform(-np.pi, np.pi, size=shape)
    added = np.stack([radii_m * np.cos(angles), radii_m * np.sin(angles), batch.positions[:, :, 2]], axis=2)
    return _compact(
        PaddedConstellations(
            np.concatenate([batch.positions, added.astype(np.float32)], axis=1),
            np.concatenate([batch.labels, rng.integers(vocabulary_size, size=shape)], axis=1),
            np.concatenate([batch.present, batch.present & (rng.random(shape) < probability)], axis=1),
        )
    )


def misclassify(
    batch: PaddedConstellations, alpha: float, vocabulary_size: int, *, rng: np.random.Generator
) -> PaddedConstellations:
    """Misclass: an object gets any other class with probability ``|p_i| / max_j |p_j| * alpha``."""
    lengths_m = _lengths(batch)
    farthest_m = lengths_m.max(axis=1, keepdims=True, initial=0.0)
    # Compared without the division, which a centre on its own does not allow.
    confused = rng.random(lengths_m.shape) * farthest_m < lengths_m * alpha
    others = (batch.labels + rng.integers(1, vocabulary_size, size=lengths_m.shape)) % vocabulary_size
    return replace(batch, labels=np.where(confused, others, batch.labels))


def crop(batch: PaddedConstellations, shares: Range, *, rng: np.random.Generator) -> PaddedConstellations:
    """Crop: objects go if ``p_i,xi > max_j |p_j| (1 - e)``, with one share ``e`` for each constellation.

    The axis ``xi`` is x or y with equal probability: no object lies that far up.
    """
    limits_m = _lengths(batch).max(axis=1, initial=0.0) * (1.0 - rng.uniform(*shares, len(batch)))
    along = batch.positions[np.arange(len(batch)), :, rng.integers(2, size=len(batch))].astype(np.float64)
    return _keep(batch, along <= limits_m[:, None])


def scale(batch: PaddedConstellations, factors: Range, *, rng: np.random.Generator) -> PaddedConstellations:
    """Scale: ``s p_i``, with one factor ``s`` for each constellation."""
    return _moved(batch, batch.positions * rng.uniform(*factors, (len(batch), 1, 1)))


def _moved(batch: PaddedConstellations, positions: NDArray[np.float64]) -> PaddedConstellations:
    return replace(batch, positions=positions.astype(np.float32))


def _keep(batch: PaddedConstellations, kept: NDArray[np.bool_]) -> PaddedConstellations:
    """The objects of ``kept`` (B, N), and the centres."""
    present = batch.present & kept
    present[:, :1] = True
    return _compact(replace(batch, present=present))


def _compact(batch: PaddedConstellations) -> PaddedConstellations:
    """The same objects in the same order, without holes between them and with no more room than they need."""
    order = np.argsort(~batch.present, axis=1, kind="stable")
    order = order[:, : int(batch.present.sum(axis=1).max(initial=1))]
    present = np.take_along_axis(batch.present, order, axis=1)
    positions = np.take_along_axis(batch.positions, order[:, :, None], axis=1)
    labels = np.take_along_axis(batch.labels, order, axis=1)
    return PaddedConstellations(
        np.where(present[:, :, None], positions, np.float32(0.0)), np.where(present, labels, 0), present
    )


def _lengths(batch: PaddedConstellations) -> NDArray[np.float64]:
    """Distances (B, N) m from the centre, 0 where nothing is."""
    return np.asarray(np.linalg.norm(batch.positions.astype(np.float64), axis=2))
