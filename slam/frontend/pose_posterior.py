"""The pose of the body from one scan: a posterior over poses among the landmarks around, with a mixture prior.

The pose is off from the predicted one by xi = (phi, tau): a small rotation about the body and a shift. Its prior is a
mixture of Gaussians: the odometry with its noise, and an odometry that errs by as much as the body moves. The scan has
detections z_k of landmarks m_j, whose predicted offsets have a joint covariance. With o the offset of a landmark,

    z_k - m_j = A xi + e_j + n_k,      A = [[o]x  -I],

where e_j is what the error of a landmark does not share with the others. Each mode maximises

    p(xi) prod_k [ N(z_k - m_j; A xi, E_j + R_k) p(label_k | j) / lambda    or    1 where k has no landmark ],

over xi and the assignment, and is weighted by the integral around it (Laplace's approximation: MacKay, Information
Theory, Inference, and Learning Algorithms, 2003, ch. 27). A single pair proposes a mode, as in RANSAC, by the Kalman
update of xi with it; the best ones are refined with all pairs in their gates. Conditioning on a pair is what makes the
others compatible with it (joint compatibility: Neira and Tardos, IEEE T-RA 2001).
"""

from collections.abc import Sequence
from dataclasses import field
from itertools import combinations

import numpy as np
from scipy.spatial import cKDTree
from scipy.spatial.distance import cdist
from scipy.special import logsumexp

from logs.records import frozen
from slam.common.arrays import FloatArray, IntArray
from slam.common.calibration import ObjectCalibration
from slam.common.geometry import (
    apply,
    invert,
    make_transform,
    rotation_angle_rad,
    rotation_of,
    skew,
    transform_from_xyz_yaw,
)
from slam.frontend.data_association import (
    EXCLUDED_RATIO,
    MATCH_GATE,
    NEW,
    Assignment,
    Objects,
    associate,
    density,
    label_likelihood,
    other_shares,
    squared_distances,
)

SEED_DETECTIONS = 6
"""Detections, the nearest ones, whose pairs propose modes: more than one of them is of a landmark."""
MAX_SEEDS = 64
MAX_PROPOSALS = 200
"""Motions that one pair of detections proposes."""
SCORED_AT_ONCE = 256
REFINED_SEEDS = 6
"""Proposed modes that are refined, those with the highest scores."""
SAME_POSE_GATE = 16.8
"""Chi-squared with 6 degrees of freedom at 99 %."""
REFINEMENTS = 3
"""Assignments and Gauss-Newton steps in turn."""


@frozen
class KnownLandmarks:
    """The L landmarks around: positions (L, 3) m, class probabilities (L, C), and the covariance ``joint`` (3 L, 3 L)
    m^2 of their offsets from the body, local axes.
    """

    positions: FloatArray
    beliefs: FloatArray
    joint: FloatArray


@frozen
class PriorComponent:
    """A Gaussian of the mixture: its weight, the covariance (6, 6) that it adds to the error of the pose, rotation
    before translation, local axes, and the motion (4, 4) in the local frame to its mean from the predicted pose.

    ``is_anywhere``: the covariance is so wide that modes are proposed by pairs of detections.
    """

    weight: float
    added: FloatArray
    T_motion: FloatArray = field(default_factory=lambda: np.eye(4))
    is_anywhere: bool = False


@frozen
class Mode:
    """A pose: the motion (4, 4) to it from the predicted one, local frame, and the covariance (6, 6) of its error.

    ``component``: of the prior; ``log_weight``: of the posterior, up to a constant; ``assignment``: of the detections;
    ``log_likelihood_ratio``: of its pairs, against objects of no landmark.
    """

    T_motion: FloatArray
    covariance: FloatArray
    component: PriorComponent
    log_weight: float
    assignment: Assignment
    log_likelihood_ratio: float = 0.0


class ModeSearch:
    """The posterior of the pose at one scan."""

    def __init__(self, seen: Objects, known: KnownLandmarks, origin: FloatArray, config: ObjectCalibration) -> None:
        """``seen``: the detections as seen from the predicted pose of the body, whose position is ``origin`` (3,) m."""
        self._seen = seen
        self._known = known
        self._origin = origin
        around = density(known.positions, known.joint)
        self._config = config.model_copy(update={"new_object_density": around})
        self._tree = cKDTree(known.positions)
        self._common, self._own = common_error(known.positions - origin, known.joint)

    @property
    def is_pose_uncertain(self) -> bool:
        """Whether the common error of all landmarks is larger than the own error of each with that of its detection."""
        A = _jacobians(self._seen.positions - self._origin)
        common = np.einsum("kij,jl,kil->k", A, self._common, A)
        own = np.trace(self._seen.covariances, axis1=1, axis2=2) + np.median(np.trace(self._own, axis1=1, axis2=2))
        return bool(np.median(common) > np.median(own))

    def modes(self, components: Sequence[PriorComponent]) -> list[Mode]:
        """All modes, the likeliest first; of several with the same assignment the best is kept.

        One of them is a place where nothing is known, by any component; where a wide one finds places that look alike,
        that may look like them.
        """
        best = dict[bytes, Mode]()
        count = len(self._seen.positions)
        none = Assignment(np.full(count, NEW, dtype=np.int64), np.zeros(count))
        log_weight = -np.inf
        for component in components:
            found = self._modes_of(component)
            elsewhere = _log_elsewhere(found) if component.is_anywhere else 0.0
            log_weight = float(np.logaddexp(log_weight, np.log(component.weight) + elsewhere))
            for mode in found:
                key = np.maximum(mode.assignment.landmark_rows, NEW).tobytes()
                if key not in best or best[key].log_weight < mode.log_weight:
                    best[key] = mode
        nowhere = Mode(components[0].T_motion, self._common, components[0], log_weight, none)
        best[none.landmark_rows.tobytes()] = nowhere
        return sorted(best.values(), key=lambda mode: -mode.log_weight)

    def _modes_of(self, component: PriorComponent) -> list[Mode]:
        """The modes of a component."""
        prior = self._common + component.added
        if component.is_anywhere:
            T_motion = self._proposals()
            xi, covariances = np.zeros((len(T_motion), 6)), np.tile(self._common, (len(T_motion), 1, 1))
        else:
            xi, covariances = self._seeds(self._placed(component.T_motion), prior)
            T_motion = np.tile(component.T_motion, (len(xi), 1, 1))
        seeds = self._best_seeds(T_motion, xi, covariances, prior).tolist()
        return [self._refined(T_motion[seed], xi[seed], covariances[seed], component) for seed in seeds]

    def _proposals(self) -> FloatArray:
        """Motions (S, 4, 4), upright, that lay two detections on two landmarks as far apart."""
        seen, known = self._seen, self._known
        if len(seen.positions) < 2:
            return np.zeros((0, 4, 4))
        sigma_m = np.sqrt(np.median(np.trace(seen.covariances, axis1=1, axis2=2)) / 3.0)
        tolerance_m = sigma_m * MATCH_GATE**0.5
        apart_m = cdist(known.positions[:, :2], known.positions[:, :2])
        likely = label_likelihood(known.beliefs, known.beliefs.shape[1], self._config)
        found = [np.zeros((0, 4, 4))]
        for a, b in combinations(self._nearest(seen).tolist(), 2):
            baseline = seen.positions[b, :2] - seen.positions[a, :2]
            length_m = np.linalg.norm(baseline)
            if length_m < 2.0 * tolerance_m:
                continue
            misfit_m = np.abs(apart_m - length_m)
            labels = np.outer(likely[:, seen.labels[a]], likely[:, seen.labels[b]])
            i, j = np.nonzero((misfit_m < tolerance_m) & (labels > EXCLUDED_RATIO * labels.max(initial=0.0)))
            best = np.argsort(misfit_m[i, j], kind="stable")[:MAX_PROPOSALS]
            i, j = i[best], j[best]
            vector = known.positions[j, :2] - known.positions[i, :2]
            turn = np.arctan2(vector[:, 1], vector[:, 0]) - np.arctan2(baseline[1], baseline[0])
            T = transform_from_xyz_yaw(np.zeros((len(i), 3)), turn)
            T[:, :3, 3] = known.positions[i] - T[:, :3, :3] @ seen.positions[a]
            found.append(T)
        return np.concatenate(found)

    def _nearest(self, seen: Objects) -> IntArray:
        """The detections nearest to the body, whose pairs propose modes."""
        return np.argsort(np.linalg.norm(seen.positions - self._origin, axis=1), kind="stable")[:SEED_DETECTIONS]

    def _placed(self, T_motion: FloatArray) -> Objects:
        """The detections after a motion (4, 4) of the body."""
        R = T_motion[:3, :3]
        return Objects(apply(T_motion, self._seen.positions), R @ self._seen.covariances @ R.T, self._seen.labels)

    def _seeds(self, seen: Objects, prior: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Poses xi (S, 6), with their covariances (S, 6, 6): the predicted one, and those by one pair each."""
        known = self._known
        nearest = self._nearest(seen)
        k, j = np.repeat(nearest, len(known.positions)), np.tile(np.arange(len(known.positions)), len(nearest))
        A = _jacobians(seen.positions[k] - self._origin)
        S = A @ prior @ A.swapaxes(1, 2) + self._own[j] + seen.covariances[k]
        r = seen.positions[k] - known.positions[j]
        distances, _ = squared_distances(r, S)
        likelihoods = label_likelihood(known.beliefs[j, seen.labels[k]], known.beliefs.shape[1], self._config)
        cost = distances - 2.0 * np.log(likelihoods)
        chosen = np.flatnonzero(distances < MATCH_GATE)
        chosen = chosen[np.argsort(cost[chosen], kind="stable")[:MAX_SEEDS]]
        PA = prior @ A[chosen].swapaxes(1, 2)
        gain = PA @ np.linalg.inv(S[chosen])
        xi = np.concatenate([np.zeros((1, 6)), np.einsum("sij,sj->si", gain, r[chosen])])
        return xi, np.concatenate([prior[None], prior - gain @ PA.swapaxes(1, 2)])

    def _best_seeds(self, T_motion: FloatArray, xi: FloatArray, covariances: FloatArray, prior: FloatArray) -> IntArray:
        """Of proposed poses (S,), those worth refining: of all with the same matches the best one."""
        if not len(xi):
            return np.zeros(0, dtype=np.int64)
        chunks = [slice(start, start + SCORED_AT_ONCE) for start in range(0, len(xi), SCORED_AT_ONCE)]
        found = [self._scores(T_motion[chunk], xi[chunk], covariances[chunk]) for chunk in chunks]
        scores = np.concatenate([each for each, _ in found]) - 0.5 * _mahalanobis(xi, prior)
        matches = np.concatenate([each for _, each in found])
        order = np.argsort(-scores, kind="stable")
        _, first = np.unique(matches[order], axis=0, return_index=True)
        return order[np.sort(first)[:REFINED_SEEDS]]

    def _scores(self, T_motion: FloatArray, xi: FloatArray, covariances: FloatArray) -> tuple[FloatArray, IntArray]:
        """Log-likelihood ratio (S,) of each proposed pose, and the landmark (S, D) that it has for each detection: the
        nearest one, negative where none is likelier.
        """
        seen, known = self._seen, self._known
        origins = T_motion[:, :3, :3] @ self._origin + T_motion[:, :3, 3]
        offsets = (seen.positions - self._origin) @ T_motion[:, :3, :3].swapaxes(1, 2)
        moved = offsets @ rotation_of(xi[:, :3]).swapaxes(1, 2) + (origins + xi[:, 3:])[:, None]
        _, nearest = self._tree.query(moved)
        A = _jacobians(offsets)
        S = A @ covariances[:, None] @ A.swapaxes(2, 3) + self._own[nearest] + seen.covariances
        labels = np.broadcast_to(seen.labels, nearest.shape).ravel()
        r = (moved - known.positions[nearest]).reshape(-1, 3)
        ratios = self._pair_llrs(r, S.reshape(-1, 3, 3), labels, nearest.ravel()).reshape(nearest.shape)
        return np.maximum(ratios, 0.0).sum(axis=1), np.where(ratios > 0.0, nearest, NEW)

    def _pair_llrs(self, r: FloatArray, S: FloatArray, labels: IntArray, landmarks: IntArray) -> FloatArray:
        """Log-likelihood ratio (N,) of pairs of a detection's label and a landmark that are ``r`` (N, 3) m apart,
        against an object of no landmark.
        """
        distances, determinants = squared_distances(r, S)
        beliefs = self._known.beliefs
        log_label = np.log(label_likelihood(beliefs[landmarks, labels], beliefs.shape[1], self._config))
        log_clutter = np.log(self._config.new_object_density * other_shares(labels, landmarks, beliefs))
        return log_label - log_clutter - 0.5 * (distances + np.log((2.0 * np.pi) ** 3 * determinants))

    def _refined(self, T_motion: FloatArray, xi: FloatArray, covariance: FloatArray, component: PriorComponent) -> Mode:
        """The mode near a pose that is off by xi from that after a motion, with all pairs in its gates."""
        seen, known = self._placed(T_motion), self._known
        origin = T_motion[:3, :3] @ self._origin + T_motion[:3, 3]
        prior = self._common + component.added
        A = _jacobians(seen.positions - origin)
        information = np.linalg.inv(prior)
        for _ in range(REFINEMENTS):
            moved = apply(_motion_of(xi, origin), seen.positions)
            spread = A @ covariance @ A.swapaxes(1, 2) + seen.covariances
            found = associate(
                Objects(moved, spread, seen.labels), known.positions, self._own, known.beliefs, self._config
            )
            k = np.flatnonzero(found.matched)
            j = found.landmark_rows[k]
            r, S = seen.positions[k] - known.positions[j], self._own[j] + seen.covariances[k]
            weighted = np.linalg.solve(S, A[k])
            covariance = np.linalg.inv(information + np.einsum("nij,nik->jk", A[k], weighted))
            xi = covariance @ np.einsum("nij,ni->j", weighted, r)
        llr = float(self._pair_llrs(r - A[k] @ xi, S, seen.labels[k], j).sum())
        occam = 0.5 * (np.linalg.slogdet(covariance)[1] - np.linalg.slogdet(prior)[1])
        log_weight = float(np.log(component.weight)) + llr - 0.5 * float(_mahalanobis(xi[None], prior)[0]) + occam
        return Mode(_motion_of(xi, origin) @ T_motion, covariance, component, log_weight, found, llr)


def probabilities(modes: Sequence[Mode]) -> FloatArray:
    """Posterior probabilities of modes."""
    log_weights = np.array([mode.log_weight for mode in modes])
    return np.exp(log_weights - logsumexp(log_weights))


def _log_elsewhere(modes: Sequence[Mode]) -> float:
    """Log-likelihood ratio to clutter of a place outside the area of the landmarks around, against the likeliest of
    ``modes`` in it.

    It looks like clutter, or as another of those poses that fits better than clutter: a robot keeps to its way along a
    pattern, so that it is aligned with it there, too.
    """
    if not modes:
        return 0.0
    best = max(modes, key=lambda mode: mode.log_weight)
    better = [mode for mode in modes if mode.log_weight > np.log(mode.component.weight)]
    ratios = [0.0, *(mode.log_likelihood_ratio for mode in better if not is_same_pose(best, mode))]
    return float(logsumexp(ratios) - np.log(len(ratios)))


def is_same_pose(a: Mode, b: Mode) -> bool:
    """Whether two modes do not differ by more than their noise."""
    T = a.T_motion @ invert(b.T_motion)
    turn, shift = float(rotation_angle_rad(T)), T[:3, 3]
    covariance = a.covariance + b.covariance
    turned, shifted = np.trace(covariance[:3, :3]) / 3.0, np.trace(covariance[3:, 3:]) / 3.0
    return bool(shift @ shift / shifted + turn**2 / turned < SAME_POSE_GATE)


def common_error(offsets: FloatArray, joint: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Covariance (6, 6) of the pose error that landmarks share, and of what each has of its own, (L, 3, 3) m^2.

    The shared one is the least-squares fit of a motion of the body to the errors of the ``offsets`` (L, 3) m, whose
    covariance is ``joint`` (3 L, 3 L) m^2.
    """
    A, fit = _jacobians(offsets), fit_of(offsets)
    fitted = fit @ joint
    common = fitted @ fit.T
    # Blocks of (I - A fit) joint (I - A fit)^T.
    columns = np.arange(3 * len(A)).reshape(-1, 3)
    cross = A @ fitted.reshape(6, -1, 3).transpose(1, 0, 2)
    own = joint[columns[:, :, None], columns[:, None, :]] - cross - cross.swapaxes(1, 2)
    own += A @ common @ A.swapaxes(1, 2)
    scale = np.mean(np.sum(offsets**2, axis=1))
    return common + np.diag(np.repeat([1e-8, 1e-8 * scale], 3)), own


def fit_of(offsets: FloatArray) -> FloatArray:
    """Matrix (6, 3 L) of the least-squares fit of xi to differences z - m of detections at ``offsets`` (L, 3) m."""
    scale = max(np.sqrt(np.mean(np.sum(offsets**2, axis=1))), 1e-9)
    units = np.repeat([scale, 1.0], 3)
    A = _jacobians(offsets).reshape(-1, 6) / units
    return np.linalg.pinv(A.T @ A, rcond=1e-6, hermitian=True) @ A.T / units[:, None]


def _motion_of(xi: FloatArray, origin: FloatArray) -> FloatArray:
    """The transform (4, 4) in the local frame that turns about the body at ``origin`` and shifts by xi (6,)."""
    R = rotation_of(xi[:3])
    return make_transform(R, origin + xi[3:] - R @ origin)


def _jacobians(offsets: FloatArray) -> FloatArray:
    """(..., 3, 6) of the differences z - m of detections at ``offsets`` (..., 3) m from the body, by xi."""
    A = np.zeros((*offsets.shape[:-1], 3, 6))
    A[..., :3] = skew(offsets)
    A[..., [0, 1, 2], [3, 4, 5]] = -1.0
    return A


def _mahalanobis(xi: FloatArray, covariance: FloatArray) -> FloatArray:
    """Squared distances (S,) of xi (S, 6)."""
    return np.einsum("si,si->s", xi, np.linalg.solve(covariance, xi.T).T)
