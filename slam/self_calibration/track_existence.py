"""Probability that a track is of an object, and not of false detections that are near each other by chance.

Where detections lie at random, the nearest one within a room around the end of a track is at a squared distance that is
even over the room: w = -log(distance^2 / room^2) has an exponential distribution of mean 1. What continues the track of
an object is nearer: of mean 1 / a > 1. A track by chance continues with a probability q, that of an object with p. The
likelihoods of a track with n links are

    chance: q^n (1 - q) exp(-sum w)          object: p^n (1 - p) a^n exp(-a sum w)

and expectation maximisation finds p, q, a and the share of objects from all tracks of a log (Dempster, Laird and Rubin,
J. Royal Statistical Society B, 1977): the existence probability of integrated tracking (Musicki, Evans and Stankovic,
IEEE Trans. Automatic Control, 1994), with clutter that is estimated from the log. No length and no noise is known.
"""

from __future__ import annotations

import numpy as np

from slam.common.arrays import FloatArray

ROUNDS, CONVERGED = 200, 1e-6
LEAST = 1e-6
"""Probabilities stay that far from 0 and 1."""


def existence_probabilities(links: FloatArray, closeness: FloatArray) -> FloatArray:
    """Probability (T,) that a track is of an object, from its ``links`` (T,) and the sum of their w (T,)."""
    share, p, q, a = 0.5, 0.9, 0.3, 0.3
    objects, before = np.full(len(links), share), -np.inf
    if not len(links):
        return objects
    for _ in range(ROUNDS):
        of_object = np.log(share) + links * np.log(p * a) + np.log1p(-p) - a * closeness
        by_chance = np.log1p(-share) + links * np.log(q) + np.log1p(-q) - closeness
        likelihood = np.logaddexp(of_object, by_chance)
        objects = np.exp(of_object - likelihood)
        mean = likelihood.mean()
        if abs(mean - before) < CONVERGED:
            break
        before = mean
        share, p, q = _probability(objects.mean()), _goes_on(links, objects), _goes_on(links, 1.0 - objects)
        q = min(p, q)
        a = float(np.clip(objects @ links / max(float(objects @ closeness), LEAST), LEAST, 1.0))
    return objects


def _goes_on(links: FloatArray, weights: FloatArray) -> float:
    """Probability that a track continues, of tracks with weights (T,)."""
    return _probability(float(weights @ links) / max(float(weights @ (links + 1)), LEAST))


def _probability(value: float) -> float:
    return float(np.clip(value, LEAST, 1.0 - LEAST))
