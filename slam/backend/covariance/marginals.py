"""Marginal covariances of all keyframes and landmarks at once."""

from __future__ import annotations

import logging
from collections.abc import Sequence
from dataclasses import dataclass

import gtsam
import numpy as np
from gtsam.symbol_shorthand import L, X
from numpy.typing import NDArray
from scipy import sparse

from slam.backend.covariance.covariance_estimation import (
    POSE_SIZE,
    LinearSystem,
    covariance_blocks,
    outlier_limit,
    variance_factors,
)
from slam.backend.factors import CLOSURE_KERNEL_WIDTH, Edge, EdgeKind, Factor, LandmarkPrior, Observation
from slam.common.arrays import FloatArray, IntArray

logger = logging.getLogger(__name__)

KeyArray = NDArray[np.uint64]
POINT_SIZE = 3


@dataclass(frozen=True, slots=True, eq=False)
class Marginals:
    """Covariances of all variables of a graph.

    poses (K, 6, 6): rotation [rad] first, then translation [m], of the right perturbation ``T_map_body Exp(xi)``, that
    is, about the axes of the body; points (L, 3, 3) m^2, map frame. pose_keys (K,) and point_keys (L,) are GTSAM's,
    ascending.
    """

    pose_keys: KeyArray
    point_keys: KeyArray
    poses: FloatArray
    points: FloatArray

    def of_keyframes(self, keyframes: IntArray) -> FloatArray:
        """Covariances (N, 6, 6) of keyframes (N,) that are in the graph."""
        return self.poses[np.searchsorted(self.pose_keys, _keys(X(0), keyframes))]

    def of_landmarks(self, landmarks: IntArray) -> FloatArray:
        """Covariances (N, 3, 3) m^2 of landmarks (N,) that are in the graph."""
        return self.points[np.searchsorted(self.point_keys, _keys(L(0), landmarks))]


def compute_marginals(
    graph: gtsam.NonlinearFactorGraph, values: gtsam.Values, factors: Sequence[Factor], kernel_width: float
) -> Marginals:
    """Covariances of all variables of an optimised graph, with the noise that the drive itself shows.

    The estimation of the noise is described in ``slam.backend.covariance.covariance_estimation``. GTSAM's own marginals
    eliminate anew for each variable, which takes ten times as long where loops are closed.

    Args:
        graph: its factors, among them empty places.
        values: the optimum.
        factors: what each factor of the graph was made of, in its order, without the empty places.
        kernel_width: of the observations, in standard deviations.

    Raises:
        np.linalg.LinAlgError: the graph does not determine all variables.
    """
    keys, points = _ordered_keys(values)
    system = _linearize(graph, values, factors, kernel_width)
    blocks = covariance_blocks(system, variance_factors(system))
    return Marginals(keys[points:], keys[:points], blocks[points:], blocks[:points, :POINT_SIZE, :POINT_SIZE].copy())


def matched_covariances(
    graph: gtsam.NonlinearFactorGraph, values: gtsam.Values, factors: Sequence[Factor], kernel_width: float
) -> list[FloatArray | None]:
    """For each factor the covariance (6, 6) that the drive itself shows; None where it is the configured one.

    Arguments as of ``compute_marginals``.
    """
    system = _linearize(graph, values, factors, kernel_width)
    try:
        found = variance_factors(system)
    except np.linalg.LinAlgError as error:
        logger.info("the noise stays as it is configured: %s", error)
        return [None] * len(factors)
    parts = np.split(found, np.cumsum(_sizes(factors))[:-1])
    return [
        _scaled(each.covariance, part) if isinstance(each, Edge) and np.any(part != 1.0) else None
        for each, part in zip(factors, parts, strict=True)
    ]


def _scaled(covariance: FloatArray, factors: FloatArray) -> FloatArray:
    """A covariance (6, 6) with variances scaled by ``factors`` (6,) along the axes that GTSAM whitens."""
    axes = np.linalg.cholesky(covariance[::-1, ::-1])[::-1, ::-1]
    return np.asarray((axes * factors) @ axes.T)


def _ordered_keys(values: gtsam.Values) -> tuple[KeyArray, int]:
    """The keys (V,) of all variables, ascending, as the columns stand; and how many are landmarks, which come first."""
    keys = np.array(sorted(values.keys()), dtype=np.uint64)
    return keys, int(np.searchsorted(keys, np.uint64(X(0))))


def _sizes(factors: Sequence[Factor]) -> IntArray:
    """Rows (F,) of factors."""
    is_small = np.array([isinstance(each, Observation | LandmarkPrior) for each in factors])
    return np.where(is_small, POINT_SIZE, POSE_SIZE)


def _linearize(
    graph: gtsam.NonlinearFactorGraph,
    values: gtsam.Values,
    factors: Sequence[Factor],
    kernel_width: float,
) -> LinearSystem:
    keys, points = _ordered_keys(values)
    owners = np.repeat(np.arange(len(keys)), np.where(np.arange(len(keys)) < points, POINT_SIZE, POSE_SIZE))
    sizes = _sizes(factors)
    starts = np.cumsum(sizes) - sizes
    row, column, entry = np.asarray(graph.linearize(values).sparseJacobian_())
    # Both are counted from one; the last column is the right side.
    row, column = row.astype(np.int32) - 1, column.astype(np.int32) - 1
    is_right = column == len(owners)
    shape = (int(sizes.sum()), len(owners))
    weighted = np.zeros(shape[0])
    weighted[row[is_right]] = entry[is_right]
    unweighting, kernel_weight = _undo_kernels(factors, np.add.reduceat(weighted**2, starts), kernel_width)
    scale = np.repeat(unweighting, sizes)
    places = (row[~is_right], column[~is_right])
    jacobian = sparse.csr_array((entry[~is_right] * scale[row[~is_right]], places), shape=shape)
    kinds = np.array([each.kind if isinstance(each, Edge) else "" for each in factors])
    rows = starts[:, None] + np.arange(POSE_SIZE)
    kernel_weights = np.repeat(kernel_weight, sizes)
    is_closure = kinds == EdgeKind.LOOP_CLOSURE
    return LinearSystem(
        jacobian, weighted * scale, kernel_weights, rows[(kinds != "") & ~is_closure], rows[is_closure], owners
    )


def _undo_kernels(factors: Sequence[Factor], squares: FloatArray, kernel_width: float) -> tuple[FloatArray, FloatArray]:
    """What takes the kernels' weights off the rows of factors (F,), but for those of outliers, and the factors'
    kernel weights.

    ``squares`` (F,) are their squared residuals after the weighing.
    """
    scale, kernel_weight = np.ones(len(factors)), np.ones(len(factors))
    is_observation = np.array([isinstance(each, Observation) for each in factors])
    inflations = np.array([each.covariance_inflation for each in factors if isinstance(each, Observation)])
    is_closure = np.array([isinstance(each, Edge) and each.kind == EdgeKind.LOOP_CLOSURE for each in factors])
    for chosen, width, own, size in (
        (is_observation, kernel_width, inflations, POINT_SIZE),
        (is_closure, CLOSURE_KERNEL_WIDTH, 1.0, POSE_SIZE),
    ):
        if chosen.any():
            # GTSAM multiplies rows by the root of the weight w = 1 / (1 + r^2), so w r^2 = 1 - w. The slope of w r is
            # w - 2 w (1 - w) along r and w across it; ``slopes`` are the mean over all directions.
            weights = np.maximum(1.0 - squares[chosen] * own / width**2, 1e-12)
            slopes = weights - 2.0 * weights * (1.0 - weights) / size
            is_outlier = squares[chosen] * own / weights > outlier_limit(size)
            scale[chosen] = np.where(is_outlier, 1.0, 1.0 / np.sqrt(weights))
            kernel_weight[chosen] = slopes.mean()
    return scale, kernel_weight


def _keys(first: int, numbers: IntArray) -> KeyArray:
    return np.uint64(first) + numbers.astype(np.uint64)
