"""Marginal covariances of all keyframes and landmarks at once."""

from collections import defaultdict
from collections.abc import Iterable

import gtsam
import numpy as np

from slam.backend.solver import graph_of
from slam.common.arrays import FloatArray


def compute_marginals(factors: Iterable[gtsam.NonlinearFactor], values: gtsam.Values) -> dict[int, FloatArray]:
    """Covariances, (6, 6) of poses and (3, 3) of points, of all variables of an optimised graph, by their keys.

    Elimination leaves ``R x + S y = d`` for each variable x, given those y that follow. With the covariance P of y,
    ``A = -R^-1 S``, that of x is ``R^-1 R^-T + A P A^T``, and ``A P`` that of both. All of y, but for the first one,
    are what that one is given, so the covariances follow from the last variable to the first. GTSAM's own marginals
    eliminate anew for each variable, which takes twenty times as long where loops are closed.

    Raises:
        RuntimeError: the graph does not determine all variables.
    """
    net = without_kernels(factors, values).linearize(values).eliminateSequential()
    conditionals = {(each := net.at(row)).firstFrontalKey(): each for row in range(net.size())}
    order = {key: row for row, key in enumerate(conditionals)}
    children = defaultdict[int | None, list[int]](list)
    for key, conditional in conditionals.items():
        children[min(conditional.keys()[1:], key=order.__getitem__, default=None)].append(key)
    covariances = {}
    waiting = [(key, np.zeros(0, dtype=np.int64), np.zeros((0, 0))) for key in children[None]]
    while waiting:
        key, given, P = waiting.pop()
        conditional = conditionals[key]
        rows = np.concatenate([np.flatnonzero(given == each) for each in conditional.keys()[1:]] or [given])
        P = P.take(rows, axis=0).take(rows, axis=1)
        R_inverse = np.linalg.inv(conditional.R())
        A = -R_inverse @ conditional.S()
        across = A @ P
        covariances[key] = own = R_inverse @ R_inverse.T + across @ A.T
        joint = np.block([[own, across], [across.T, P]])
        owners = np.concatenate([np.full(len(own), key), given[rows]])
        # Those without children are done at once, so that few joint covariances wait.
        waiting += [(child, owners, joint) for child in sorted(children[key], key=lambda child: -len(children[child]))]
    return covariances


def offset_covariances(
    factors: Iterable[gtsam.NonlinearFactor], values: gtsam.Values, pairs: Iterable[tuple[int, int]]
) -> FloatArray:
    """Covariances (P, 3, 3) of the differences between the points of pairs of keys, of an optimised graph.

    With ``R^T R`` the information of all variables, the covariance of ``g^T x`` is that of ``R^-T g`` with itself.

    Raises:
        RuntimeError: the graph does not determine all variables.
    """
    net = without_kernels(factors, values).linearize(values).eliminateSequential()
    zeros = gtsam.VectorValues()
    for row in range(net.size()):
        zeros.insert(net.at(row).firstFrontalKey(), np.zeros(len(net.at(row).R())))
    found = []
    for pair in pairs:
        solved = []
        for axis in np.eye(3):
            g = gtsam.VectorValues(zeros)
            for key, sign in zip(pair, (1.0, -1.0), strict=True):
                of_one = gtsam.VectorValues()
                of_one.insert(key, sign * axis)
                g.update(of_one)
            solved.append(net.backSubstituteTranspose(g).vector())
        found.append(np.array(solved) @ np.array(solved).T)
    return np.array(found).reshape(-1, 3, 3)


def without_kernels(factors: Iterable[gtsam.NonlinearFactor], values: gtsam.Values) -> gtsam.NonlinearFactorGraph:
    """A graph of factors at their optimum ``values``, with kernels at outliers only.

    Kernels weight observations and closures, by about half in the mean where the configured noise is true. These
    weights are not an estimate of the noise: in covariances all but outliers count with the noise that is configured.
    """
    return graph_of(_without_kernel(factor, values) for factor in factors)


def _without_kernel(factor: gtsam.NonlinearFactor, values: gtsam.Values) -> gtsam.NonlinearFactor:
    if not isinstance(factor, gtsam.NoiseModelFactor):
        return factor
    noise = factor.noiseModel()
    if not isinstance(noise, gtsam.noiseModel.Robust):
        return factor
    plain = factor.cloneWithNewNoiseModel(noise.noise())
    # Less weight than a tenth have outliers, and 1 in 1000 observations without faults.
    return plain if noise.weight(plain.whitenedError(values)) >= 0.1 else factor
