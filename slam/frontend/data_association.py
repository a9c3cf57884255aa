"""Assignment of detections to landmarks: gated and optimal, by the relative covariance.

Each pair is scored by the likelihood that the detection is that landmark (position and label together), and each
detection also by the likelihood that it is none of them, a new object or a false positive. The assignment that
maximises the product over the scan takes all pairs without competitors; the others are found by shortest augmenting
paths (Jonker and Volgenant 1987), on a sparse matrix if they are many, so that a scan of thousands of detections costs
no more than its neighbourhoods.
"""

from dataclasses import replace

import numpy as np
from scipy.optimize import linear_sum_assignment
from scipy.sparse import csr_array
from scipy.sparse.csgraph import min_weight_full_bipartite_matching
from scipy.spatial import cKDTree
from scipy.spatial.distance import cdist
from scipy.special import chdtri

from logs.records import frozen
from slam.common.arrays import BoolArray, FloatArray, IntArray, median
from slam.common.calibration import ObjectCalibration
from slam.object_map.landmarks import shares_but_one

NEW, AMBIGUOUS = -1, -2
MATCH_GATE = float(chdtri(3, 1.0 - 0.9995))
"""Chi-squared with 3 degrees of freedom: the gate keeps that share of true matches."""
NEW_OBJECT_GATE = float(chdtri(3, 1.0 - 0.999999))
"""A detection outside the gate of every landmark, but not as far off as that, is left out. Where labels are identities,
it is left out however far off it is, unless it is likelier a new object.
"""
DECIDED = 0.99
"""Probability from which a match, a pose or a landmark is taken to be right."""
EXCLUDED_RATIO = 0.01
"""A landmark is excluded by its label where another one is so many times likelier."""
INCONSISTENT_SIGMAS = 6.0
"""Standard deviations above the mean of a sum of squared distances, which is chi-squared."""
FEW_DISTANCES = 2**14
"""Up to so many distances, computing all is faster than building trees."""


@frozen
class Objects:
    """Detections: positions (D, 3) m, covariances (D, 3, 3) m^2, and the index (D,) of each label in the vocabulary."""

    positions: FloatArray
    covariances: FloatArray
    labels: IntArray


@frozen
class Assignment:
    """``landmark_rows`` (D,) int64: the row of each detection's landmark, ``NEW`` where it has none, ``AMBIGUOUS``
    where it has none although one is near: it may be a bad measurement of that. ``log_likelihood_ratios`` (D,): of each
    match, against a detection of no landmark; 0 for the others. ``is_contested``: a detection is near several
    landmarks, or several detections are near one. ``is_uncertain``: the predicted positions of landmarks have twice the
    variance of their detections, in the median. ``is_inconsistent``: the matches are farther apart, all together, than
    their covariances explain.
    """

    landmark_rows: IntArray
    log_likelihood_ratios: FloatArray
    is_contested: bool = False
    is_uncertain: bool = False
    is_inconsistent: bool = False

    @property
    def matched(self) -> BoolArray:
        """(D,) whether the detection has a landmark."""
        return self.landmark_rows >= 0

    def of(self, count: int) -> "Assignment":
        """That of the first detections."""
        return replace(
            self, landmark_rows=self.landmark_rows[:count], log_likelihood_ratios=self.log_likelihood_ratios[:count]
        )

    @property
    def log_likelihood_ratio(self) -> float:
        """Of all matches, against none of them."""
        return float(self.log_likelihood_ratios.sum())


def associate(
    seen: Objects,
    landmark_positions: FloatArray,
    landmark_covariances: FloatArray,
    landmark_beliefs: FloatArray,
    config: ObjectCalibration,
) -> Assignment:
    """Assign detections to landmarks, all given in one frame that is smooth around the robot.

    Args:
        seen: the D detections.
        landmark_positions: (L, 3) m, predicted.
        landmark_covariances: (L, 3, 3) m^2, of the landmarks relative to the robot.
        landmark_beliefs: (L, C) class probabilities, rows sum to 1.
        config: gate, label model and the density of new objects.

    Returns:
        The assignment; nothing is assigned twice. D = 0 or L = 0 gives no match.
    """
    positions, covariances, labels = seen.positions, seen.covariances, seen.labels
    rows, ratios = np.full(len(positions), NEW, dtype=np.int64), np.zeros(len(positions))
    if len(positions) == 0 or len(landmark_positions) == 0:
        return Assignment(rows, ratios)
    outer_gate = NEW_OBJECT_GATE
    if config.spacing_m > np.ptp(landmark_positions, axis=0).max():  # no two objects around are of one class
        outer_gate = np.inf
    detection, landmark = _near_pairs(positions, covariances, landmark_positions, landmark_covariances, outer_gate)
    if len(detection) == 0:
        return Assignment(rows, ratios)
    innovation = positions[detection] - landmark_positions[landmark]
    own, expected = covariances[detection], landmark_covariances[landmark]
    distance_squared, determinant = squared_distances(innovation, own + expected)
    classes = landmark_beliefs.shape[1]
    belief = landmark_beliefs[landmark, labels[detection]]
    likelihood = label_likelihood(belief, classes, config)
    label_cost = -2.0 * np.log(likelihood)
    pair_cost = distance_squared + np.log((2.0 * np.pi) ** 3 * determinant) + label_cost
    shares = other_shares(labels[detection], landmark, landmark_beliefs)
    none_cost = -2.0 * np.log(config.new_object_density * shares)

    # The tail of a Gaussian of any larger width: the width that fits best is that of the offset itself.
    excess = np.maximum(distance_squared / 3.0, 1.0)
    tail_cost = pair_cost + 3.0 * (1.0 + np.log(excess) - excess)
    rows[detection[(belief >= 0.5) & (distance_squared <= outer_gate) & (tail_cost < none_cost)]] = AMBIGUOUS
    inside = np.flatnonzero(distance_squared <= MATCH_GATE)
    inside = inside[pair_cost[inside] < none_cost[inside]]  # a dearer pair is in no cheapest assignment
    contested = _is_contested(detection[inside], landmark[inside])
    taken = inside[_cheapest(detection[inside], landmark[inside], none_cost[inside] - pair_cost[inside], contested)]
    rows[detection[taken]] = landmark[taken]
    ratios[detection[taken]] = 0.5 * (none_cost[taken] - pair_cost[taken])
    likeliest = np.zeros(len(positions))
    np.maximum.at(likeliest, detection[inside], likelihood[inside])
    alike = inside[likelihood[inside] > EXCLUDED_RATIO * likeliest[detection[inside]]]
    of_landmarks, of_detections = (median(np.einsum("nii->n", each)) for each in (expected, own))
    # What is near a landmark and yet outside its gate is as far off as the gate, at least.
    ambiguous = int(np.count_nonzero(rows == AMBIGUOUS))
    count, squares = len(taken) + ambiguous, distance_squared[taken].sum() + MATCH_GATE * ambiguous
    return Assignment(
        rows,
        ratios,
        is_contested=bool(_is_contested(detection[alike], landmark[alike]).any()),
        is_uncertain=of_landmarks > 2.0 * of_detections,
        is_inconsistent=squares > 3.0 * count + INCONSISTENT_SIGMAS * np.sqrt(6.0 * count),
    )


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


def density(positions: FloatArray, joint: FloatArray) -> float:
    """Objects per m^3 among N at ``positions`` (N, 3) m, whose ``joint`` covariance is (3 N, 3 N) m^2.

    The volume is that of the cylinder that holds them. Detections of one object are spread by the noise alone: by
    sqrt(2 pi e) standard deviations, the entropy of a Gaussian.
    """
    spread = np.sqrt(2.0 * np.pi * np.e * np.median(np.diagonal(joint).reshape(-1, 3), axis=0))
    radius_m = float(np.max(np.linalg.norm(positions[:, :2] - np.median(positions[:, :2], axis=0), axis=1)))
    height_m = max(float(np.ptp(positions[:, 2])), float(spread[2]))
    return len(positions) / (np.pi * max(radius_m, float(spread[:2].mean())) ** 2 * height_m)


def _is_contested(detection: IntArray, landmark: IntArray) -> BoolArray:
    """Which pairs (P,) share a detection or a landmark with another."""
    return (np.bincount(detection)[detection] > 1) | (np.bincount(landmark)[landmark] > 1)


def _cheapest(detection: IntArray, landmark: IntArray, gain: FloatArray, contested: BoolArray) -> IntArray:
    """Which pairs (P,), none of the same detection or landmark as another, gain most."""
    if not contested.any():
        return np.arange(len(detection))
    rows, row = np.unique(detection[contested], return_inverse=True)
    columns, column = np.unique(landmark[contested], return_inverse=True)
    partner = np.full(len(rows), -1)
    if len(rows) * len(columns) > FEW_DISTANCES:
        # An edge of each row to a column of its own means no landmark. One edge a row is taken, so a common shift
        # changes nothing; a weight of exactly zero would mean "no edge".
        none, cost = np.arange(len(rows)), np.append(-gain[contested], np.zeros(len(rows)))
        edges = np.append(row, none), np.append(column, len(columns) + none)
        chosen_row, chosen_column = min_weight_full_bipartite_matching(csr_array((cost + (1.0 - cost.min()), edges)))
    else:
        gains = np.zeros((len(rows), len(columns)))
        gains[row, column] = gain[contested]
        chosen_row, chosen_column = linear_sum_assignment(gains, maximize=True)
    partner[chosen_row] = chosen_column
    return np.sort(np.concatenate([np.flatnonzero(~contested), np.flatnonzero(contested)[partner[row] == column]]))


def label_likelihood(belief_in_label: FloatArray, classes: int, config: ObjectCalibration) -> FloatArray:
    """Probability (...) of a detection's label where the landmark has that class with ``belief_in_label`` (...).

    A wrong label is drawn evenly from the other classes; one class alone can only be right.
    """
    if classes < 2:
        return np.ones_like(belief_in_label)
    wrong = (1.0 - config.label_accuracy) / (classes - 1)
    return belief_in_label * config.label_accuracy + (1.0 - belief_in_label) * wrong


def other_shares(labels: IntArray, landmarks: IntArray, beliefs: FloatArray) -> FloatArray:
    """Share (P,) of the objects but one that have a label, for pairs of a label (P,) and the landmark (P,) left out.

    ``beliefs`` (L, C) are class probabilities of the landmarks.
    """
    totals = beliefs.sum(axis=0)[labels]
    return shares_but_one(totals, totals - beliefs[landmarks, labels], beliefs.shape)


def _near_pairs(
    positions: FloatArray,
    covariances: FloatArray,
    landmark_positions: FloatArray,
    landmark_covariances: FloatArray,
    gate: float,
) -> tuple[IntArray, IntArray]:
    """Pairs (detection, landmark) that can pass the gate by the largest variances: a superset of those that do."""
    radius = np.sqrt(gate * sum(np.einsum("nii->n", each).max() for each in (covariances, landmark_covariances)))
    if len(positions) * len(landmark_positions) <= FEW_DISTANCES:
        detection, landmark = np.nonzero(cdist(positions, landmark_positions) <= radius)
        return detection, landmark
    pairs = cKDTree(positions).sparse_distance_matrix(cKDTree(landmark_positions), radius, output_type="ndarray")
    order = np.lexsort((pairs["j"], pairs["i"]))
    return pairs["i"][order].astype(np.int64), pairs["j"][order].astype(np.int64)
