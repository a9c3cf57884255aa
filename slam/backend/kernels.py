"""Factors without their robust kernels.

Kernels weight observations and closures, by about half in the mean where the configured noise is true. These weights
are not an estimate of the noise: in covariances all but outliers count with the noise that is configured.
"""

from __future__ import annotations

from collections.abc import Iterable

import gtsam

OUTLIER_WEIGHT = 0.1
"""Less weight than that a kernel gives to outliers: 1 in 1000 observations without faults."""


def without_kernels(factors: Iterable[gtsam.NonlinearFactor], values: gtsam.Values) -> gtsam.NonlinearFactorGraph:
    """A graph of factors at their optimum ``values``, with kernels at outliers only."""
    graph = gtsam.NonlinearFactorGraph()
    for factor in factors:
        graph.add(_without_kernel(factor, values))
    return graph


def _without_kernel(factor: gtsam.NonlinearFactor, values: gtsam.Values) -> gtsam.NonlinearFactor:
    if not isinstance(factor, gtsam.NoiseModelFactor):
        return factor
    noise = factor.noiseModel()
    if not isinstance(noise, gtsam.noiseModel.Robust):
        return factor
    plain = factor.cloneWithNewNoiseModel(noise.noise())
    return plain if noise.weight(plain.whitenedError(values)) >= OUTLIER_WEIGHT else factor
