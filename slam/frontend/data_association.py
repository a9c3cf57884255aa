"""Which detection is which landmark: gated optimal assignment on the relative covariance.

Each pair is scored by the likelihood that the detection is that landmark (position and label together), and each
detection also by the likelihood that it is none of them, a new object or a false positive. The assignment that
maximises the product over the scan takes all pairs that nothing else competes for; the others are found by shortest
augmenting paths (Jonker and Volgenant 1987), where they are many on their sparse matrix, so that a scan of thousands of
detections costs no more than its neighbourhoods.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import linear_sum_assignment
from scipy.sparse import coo_array
from scipy.sparse.csgraph import min_weight_full_bipartite_matching
from scipy.spatial import cKDTree
from scipy.special import chdtri

from slam.common.arrays import FloatArray, IntArray
from slam.common.calibration import ObjectCalibration

NEW, AMBIGUOUS = -1, -2
GATE_PROBABILITY = 0.9995
"""Share of true matches that the chi-squared gate (3 degrees of freedom) keeps."""
NEW_OBJECT_GATE_PROBABILITY = 0.999999
"""A detection outside the gate of every landmark, but not as far off as that, is left out."""
FEW_DISTANCES = 2**14
"""So many distances are computed sooner than trees are built."""


@dataclass(frozen=True, slots=True, eq=False)
class Assignment:
    """``landmark_rows`` (D,) int64: the row of each detection's landmark, ``NEW`` where it has none,
    ``AMBIGUOUS`` where it has none although one is near: it may be a bad measurement of that.
    ``log_likelihood_ratios`` (D,): of each match, against a detection of no landmark; 0 for the others."""

    landmark_rows: IntArray
    log_likelihood_ratios: FloatArray

    @property
    def matched(self) -> NDArray[np.bool_]:
        """(D,) whether the detection has a landmark."""
        return self.landmark_rows >= 0

    @property
    def new(self) -> NDArray[np.bool_]:
        """(D,) whether the detection is of no landmark; the others are too near to one to say."""
        return np.equal(self.landmark_rows, NEW)

    @property
    def log_likelihood_ratio(self) -> float:
        """Of all matches, against none of them."""
        return float(self.log_likelihood_ratios.sum())


def associate(
    positions: FloatArray,
    covariances: FloatArray,
    labels: IntArray,
    landmark_positions: FloatArray,
    landmark_covariances: FloatArray,
    landmark_beliefs: FloatArray,
    config: ObjectCalibration,
) -> Assignment:
    """Assign detections to landmarks, all given in one frame that is smooth around the robot.

    Args:
        positions: (D, 3) m, detections.
        covariances: (D, 3, 3) m^2, of the detections.
        labels: (D,) index of each detection's label in the vocabulary.
        landmark_positions: (L, 3) m, predicted.
        landmark_covariances: (L, 3, 3) m^2, of the landmarks relative to the robot.
        landmark_beliefs: (L, C) class probabilities, rows sum to 1.
        config: gate, label model and the density of new objects.

    Returns:
        The assignment; nothing is assigned twice. D = 0 or L = 0 gives no match.
    """
    rows, ratios = np.full(len(positions), NEW, dtype=np.int64), np.zeros(len(positions))
    if len(positions) == 0 or len(landmark_positions) == 0:
        return Assignment(rows, ratios)
    gate = _gate(GATE_PROBABILITY)
    outer_gate = max(_gate(NEW_OBJECT_GATE_PROBABILITY), gate)
    detection, landmark = _near_pairs(positions, covariances, landmark_positions, landmark_covariances, outer_gate)
    if len(detection) == 0:
        return Assignment(rows, ratios)
    innovation = positions[detection] - landmark_positions[landmark]
    S = covariances[detection] + landmark_covariances[landmark]
    distance_squared, determinant = squared_distances(innovation, S)
    classes = landmark_beliefs.shape[1]
    belief = landmark_beliefs[landmark, labels[detection]]
    label_cost = -2.0 * np.log(label_likelihood(belief, classes, config))
    pair_cost = distance_squared + np.log((2.0 * np.pi) ** 3 * determinant) + label_cost
    none_cost = -2.0 * np.log(config.new_object_density / classes)

    rows[detection[(belief >= 0.5) & (distance_squared <= outer_gate)]] = AMBIGUOUS
    inside = np.flatnonzero(distance_squared <= gate)
    taken = inside[_cheapest(detection[inside], landmark[inside], pair_cost[inside], none_cost)]
    rows[detection[taken]] = landmark[taken]
    ratios[detection[taken]] = 0.5 * (none_cost - pair_cost[taken])
    return Assignment(rows, ratios)


def squared_distances(offsets: FloatArray, covariances: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Squared Mahalanobis distances (N,) of offsets (N, 3) m and the determinants (N,) of their covariances (N, 3, 3).

    By the factors L D L^T, written out: LAPACK takes a call a matrix.
    """
    x, y, z = offsets.T
    (first, _, _), (yx, yy, _), (zx, zy, zz) = covariances.transpose(1, 2, 0)
    l_yx, l_zx = yx / first, zx / first
    second, rest = yy - l_yx * yx, zy - l_zx * yx
    l_zy = rest / second
    third = zz - l_zx * zx - l_zy * rest
    y = y - l_yx * x
    z = z - l_zx * x - l_zy * y
    return x * x / first + y * y / second + z * z / third, first * second * third


@lru_cache
def _gate(probability: float) -> float:
    """The squared distance in three dimensions that is exceeded with 1 - ``probability``."""
    return float(chdtri(3, 1.0 - probability))


def _cheapest(detection: IntArray, landmark: IntArray, pair_cost: FloatArray, none_cost: float) -> IntArray:
    """Which pairs (P,), none of the same detection or landmark as another, cost least with ``none_cost`` for each
    detection that is in none.
    """
    worth = np.flatnonzero(pair_cost < none_cost)  # a dearer pair is in no cheapest assignment
    detection, landmark, pair_cost = detection[worth], landmark[worth], pair_cost[worth]
    contested = (np.bincount(detection)[detection] > 1) | (np.bincount(landmark)[landmark] > 1)
    if not contested.any():
        return worth
    (row, rows), (column, columns) = _ranks(detection[contested]), _ranks(landmark[contested])
    shape = rows, columns
    solve = _partners if rows * columns <= FEW_DISTANCES else _partners_of_many
    partner = solve(row, column, none_cost - pair_cost[contested], shape)
    return np.sort(np.concatenate([worth[~contested], worth[contested][partner[row] == column]]))


def _ranks(values: IntArray) -> tuple[IntArray, int]:
    """The rank of each of the values (N,), which are not negative, among the different ones; and how many these are."""
    ranks = np.cumsum(np.bincount(values) > 0)
    return ranks[values] - 1, int(ranks[-1])


def _partners(row: IntArray, column: IntArray, gain: FloatArray, shape: tuple[int, int]) -> IntArray:
    """The column of each row, -1 for none, that make most of the gains > 0 of the edges (E,)."""
    gains = np.zeros(shape)
    gains[row, column] = gain
    partner = np.full(shape[0], -1, dtype=np.int64)
    chosen_row, chosen_column = linear_sum_assignment(gains, maximize=True)
    partner[chosen_row] = chosen_column
    return partner


def _partners_of_many(row: IntArray, column: IntArray, gain: FloatArray, shape: tuple[int, int]) -> IntArray:
    """The same; the matrix is sparse, and an edge to a column of its own stands for none."""
    none = np.arange(shape[0])
    cost = np.concatenate([-gain, np.zeros(shape[0])])
    # One edge a row is taken, so a common shift changes nothing; a weight of exactly zero would mean "no edge".
    cost += 1.0 - cost.min()
    edges = np.concatenate([row, none]), np.concatenate([column, shape[1] + none])
    graph = coo_array((cost, edges), shape=(shape[0], sum(shape))).tocsr()
    chosen_row, chosen_column = min_weight_full_bipartite_matching(graph)
    partner = np.empty(shape[0], dtype=np.int64)
    partner[chosen_row] = chosen_column
    return partner


def label_likelihood(belief_in_label: FloatArray, classes: int, config: ObjectCalibration) -> FloatArray:
    """Probability (...) of a detection's label where the landmark has that class with ``belief_in_label`` (...).

    A wrong label is drawn evenly from the other classes; one class alone can only be right.
    """
    if classes < 2:
        return np.ones_like(belief_in_label)
    wrong = (1.0 - config.label_accuracy) / (classes - 1)
    return belief_in_label * config.label_accuracy + (1.0 - belief_in_label) * wrong


def _near_pairs(
    positions: FloatArray,
    covariances: FloatArray,
    landmark_positions: FloatArray,
    landmark_covariances: FloatArray,
    gate: float,
) -> tuple[IntArray, IntArray]:
    """Pairs (detection, landmark) that can pass the gate by the largest variances: a superset of those that do."""
    traces = (np.einsum("nii->n", each) for each in (covariances, landmark_covariances))
    radius = np.sqrt(gate * sum(float(trace.max()) for trace in traces))
    if len(positions) * len(landmark_positions) <= FEW_DISTANCES:
        offsets = positions[:, None] - landmark_positions
        detection, landmark = np.nonzero(np.einsum("dli,dli->dl", offsets, offsets) <= radius * radius)
        return detection, landmark
    pairs = cKDTree(positions).sparse_distance_matrix(cKDTree(landmark_positions), radius, output_type="ndarray")
    order = np.lexsort((pairs["j"], pairs["i"]))
    return pairs["i"][order].astype(np.int64), pairs["j"][order].astype(np.int64)
