"""Observations of one landmark from one keyframe, summed up into one."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from slam.backend.factors import Observation
from slam.common.arrays import FloatArray, IntArray


def sum_observations(
    keyframes: IntArray, landmarks: IntArray, positions: FloatArray, covariances: FloatArray, inflations: FloatArray
) -> list[Observation]:
    """One observation for each keyframe and landmark, ascending.

    Information adds up. The inflation is divided by the number of observations, so that the robust kernel stays as
    wide as for one of them.

    Args:
        keyframes: (N,) ids.
        landmarks: (N,) ids.
        positions: (N, 3) m in the frames of the keyframes.
        covariances: (N, 3, 3) m^2, inflated.
        inflations: (N,), of which the covariances are multiples.
    """
    if not len(keyframes):
        return []
    pairs, rows = np.unique(np.stack([keyframes, landmarks], axis=1), axis=0, return_inverse=True)
    rows = rows.reshape(-1)
    information = np.linalg.inv(covariances)
    summed, weighted = np.zeros((len(pairs), 3, 3)), np.zeros((len(pairs), 3))
    np.add.at(summed, rows, information)
    np.add.at(weighted, rows, np.einsum("nij,nj->ni", information, positions))
    sums = np.linalg.inv(summed)
    means = np.einsum("nij,nj->ni", sums, weighted)
    shares = np.bincount(rows, inflations) / np.bincount(rows) ** 2
    return [
        Observation(keyframe, landmark, mean, covariance, inflation)
        for (keyframe, landmark), mean, covariance, inflation in zip(
            pairs.tolist(), means, sums / shares[:, None, None], shares.tolist(), strict=True
        )
    ]


def summed(observations: Sequence[Observation]) -> list[Observation]:
    """These observations, those of one landmark from one keyframe as one."""
    return sum_observations(
        np.array([each.keyframe for each in observations]),
        np.array([each.landmark for each in observations]),
        np.array([each.position for each in observations]),
        np.array([each.covariance_inflation * each.covariance for each in observations]),
        np.array([each.covariance_inflation for each in observations]),
    )
