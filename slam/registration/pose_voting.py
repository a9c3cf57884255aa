"""Poses that many pairs of correspondences agree on.

Two correspondences determine yaw and translation. One of them held fixed, the seed, leaves only the yaw open, so each
compatible partner casts one vote in the seed's histogram of yaws: a search of C^2 pairs without a pose hypothesis
for each, as sampling (Fischler and Bolles, CACM 1981) has, and without a C x C graph of which a clique must be found,
as CLIPPER (Lusk et al., ICRA 2021) has. Partners that are the mirror image of the true ones spread over all yaws.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from slam.common.arrays import ComplexArray, FloatArray, IntArray
from slam.registration.parameters import RegistrationConfig
from slam.registration.refinement import Columns

BLOCK_PAIRS = 2**15
"""Pairs of correspondences that are tested at once: what stays in the processor's cache."""
BLOCK_POSES = 24
"""Poses with most votes that each block hands on, for each pose that is asked for."""
YAW_BINS = (24, 180)
"""Fewest and most bins of a histogram; two adjacent ones are counted together."""


@dataclass(frozen=True, slots=True, eq=False)
class PoseHypotheses:
    """``poses`` (H, 6) as rows of :class:`Columns`, most ``votes`` (H,) first; ``compatible`` pairs in all."""

    poses: FloatArray
    votes: IntArray
    compatible: int


def vote(columns: Columns, config: RegistrationConfig, *, rng: np.random.Generator, count: int) -> PoseHypotheses:
    """The poses with most votes, at most ``config.hypotheses`` times ``count``.

    All correspondences are seeds, in blocks of random order, until a pose with more support than the best one so far
    would have had a seed among those already taken with ``config.confidence``, or ``config.max_pairs`` are tested.
    """
    correspondences = len(columns)
    rows = max(BLOCK_PAIRS // correspondences, 1)
    seeds = np.arange(correspondences) if rows >= correspondences else rng.permutation(correspondences)
    voter = _YawVoter.of(columns, config)
    poses, votes, compatible, best = [], [], 0, 0
    for start in range(0, correspondences, rows):
        block_poses, block_votes, pairs = voter.count(seeds[start : start + rows], BLOCK_POSES * count)
        poses.append(block_poses)
        votes.append(block_votes)
        compatible += pairs
        best = max(best, int(block_votes.max(initial=0)))
        tested = start + rows
        missed = (1.0 - min((best + 1) / correspondences, 1.0)) ** tested
        if tested * correspondences >= config.max_pairs or (count == 1 and missed < 1.0 - config.confidence):
            break
    all_poses, all_votes = np.concatenate(poses), np.concatenate(votes)
    leading = np.argsort(-all_votes, kind="stable")
    if len(leading) > config.hypotheses * count:
        leading = leading[_first_of_cells(all_poses[leading], config)][: config.hypotheses * count]
    return PoseHypotheses(all_poses[leading], all_votes[leading], compatible)


def _first_of_cells(poses: FloatArray, config: RegistrationConfig) -> IntArray:
    """Increasing indices of the poses (H, 6) that are the first in their cell of x, y and yaw.

    Each inlier is a seed, so that without this one well supported pose would leave no room for any other.
    """
    yaw_deg = np.degrees(np.arctan2(poses[:, 1], poses[:, 0]))
    cells = np.column_stack([poses[:, 2:4] / config.distinct_m, yaw_deg / config.distinct_deg])
    x, y, yaw = np.floor(cells).astype(np.int64).T
    return np.sort(np.unique(((x << 20) + y << 10) + yaw, return_index=True)[1])


@dataclass(frozen=True, slots=True, eq=False)
class _YawVoter:
    """The C correspondences, laid out so that the lengths of all pairs are two matrix products."""

    config: RegistrationConfig
    query: ComplexArray
    """(C,) m, in the plane."""
    reference: ComplexArray
    rise: FloatArray
    """(C,) m, reference height minus query height."""
    variance: FloatArray
    """(C,) m^2, in the plane."""
    height_variance: FloatArray
    difference: tuple[FloatArray, FloatArray]
    """(C, 6) and (6, C): their product is |q_i - q_j|^2 - |r_i - r_j|^2."""
    total: tuple[FloatArray, FloatArray]
    """... and of these |q_i - q_j|^2 + |r_i - r_j|^2."""

    @classmethod
    def of(cls, columns: Columns, config: RegistrationConfig) -> _YawVoter:
        planar = np.concatenate([columns.query[:, :2], columns.reference[:, :2]], axis=1)
        squared = planar * planar
        norm_query, norm_reference = squared[:, 0] + squared[:, 1], squared[:, 2] + squared[:, 3]
        ones = np.ones(len(planar))

        def factors(signs: tuple[float, ...], norms: FloatArray) -> tuple[FloatArray, FloatArray]:
            return np.column_stack([planar * signs, norms, ones]), np.vstack([planar.T, ones, norms])

        complex_planar = planar.view(np.complex128)
        return cls(
            config,
            complex_planar[:, 0].copy(),
            complex_planar[:, 1].copy(),
            columns.reference[:, 2] - columns.query[:, 2],
            columns.sigma[:, 0] ** 2,
            columns.sigma[:, 1] ** 2,
            factors((-2.0, -2.0, 2.0, 2.0), norm_query - norm_reference),
            factors((-2.0, -2.0, -2.0, -2.0), norm_query + norm_reference),
        )

    def count(self, seeds: IntArray, keep: int) -> tuple[FloatArray, IntArray, int]:
        """Poses (H, 6) and votes (H,) of the ``keep`` seeds with most votes, and how many pairs were compatible."""
        row, partner = self._compatible(seeds)
        if len(row) == 0:
            return np.zeros((0, 6)), np.zeros(0, np.int64), 0
        seed = seeds[row]
        turn = (self.reference[partner] - self.reference[seed]) * (self.query[partner] - self.query[seed]).conj()
        bins = self._bins(seed, partner, turn)
        yaw_bin = ((np.angle(turn) + np.pi) * (bins / (2.0 * np.pi))).astype(np.int64)
        yaw_bin[yaw_bin == bins] = 0  # pi is -pi
        votes = np.bincount(row * bins + yaw_bin, minlength=len(seeds) * bins).reshape(-1, bins)
        window = votes.copy()
        window[:, :-1] += votes[:, 1:]
        window[:, -1] += votes[:, 0]
        peak = window.argmax(axis=1)
        most = np.take_along_axis(window, peak[:, None], axis=1)[:, 0]
        is_leading = np.zeros(len(seeds), dtype=bool)
        is_leading[np.argsort(-most, kind="stable")[:keep]] = True
        behind = yaw_bin - peak[row]
        voter = np.flatnonzero(((behind == 0) | (behind == 1) | (behind == 1 - bins)) & is_leading[row])
        poses, leading = self._poses(seeds, row[voter], partner[voter], turn[voter])
        return poses, most[leading], len(row)

    def _compatible(self, seeds: IntArray) -> tuple[IntArray, IntArray]:
        """Rows of ``seeds`` and their partners, whose lengths in the plane and heights agree within the noise.

        With d the lengths, (d_q - d_r)^2 <= g^2 v is (d_q^2 - d_r^2)^2 <= g^2 v (d_q + d_r)^2, and the last factor is
        2 (d_q^2 + d_r^2) up to what the gate allows: no square root is needed.
        """
        config = self.config
        difference = self.difference[0][seeds] @ self.difference[1]
        total = self.total[0][seeds] @ self.total[1]
        variance = self.variance[seeds][:, None] + self.variance
        if config.estimate_scale:
            variance += (0.5 * config.scale_sigma**2) * total
        variance *= 2.0 * config.gate_sigma**2
        variance *= total
        np.abs(difference, out=difference)
        twice_shorter_squared = total - difference
        difference *= difference
        agree = difference <= variance
        agree &= twice_shorter_squared >= 2.0 * config.min_baseline_m**2
        flat = np.flatnonzero(agree)
        row, partner = np.divmod(flat, len(self.query))
        seed = seeds[row]
        rise = self.rise[partner] - self.rise[seed]
        rise_variance = self.height_variance[partner] + self.height_variance[seed]
        rise_variance += (0.5 * config.tilt_sigma_rad**2) * total.ravel()[flat]
        level = rise * rise <= config.gate_sigma**2 * rise_variance
        return row[level], partner[level]

    def _bins(self, seed: IntArray, partner: IntArray, turn: ComplexArray) -> int:
        """So many that one is two standard deviations of a yaw wide; ``turn`` is as large as the length squared."""
        sigma = float(np.sqrt((self.variance[seed] + self.variance[partner]) / np.abs(turn)).mean())
        return int(np.clip(np.pi / sigma, *YAW_BINS))

    def _poses(
        self, seeds: IntArray, row: IntArray, partner: IntArray, turn: ComplexArray
    ) -> tuple[FloatArray, IntArray]:
        """The least-squares poses (H, 6) of seeds with their voters (V,), sorted by row; and their rows (H,)."""
        starts = np.flatnonzero(np.diff(row, prepend=-1))
        leading = row[starts]
        seed = seeds[leading]
        votes = np.stack([turn, self.query[partner], self.reference[partner], self.rise[partner] + 1j], axis=1)
        sums = np.add.reduceat(votes, starts, axis=0)
        members = sums[:, 3].imag + 1.0
        rotation = sums[:, 0] / np.abs(sums[:, 0])
        mean_query = (sums[:, 1] + self.query[seed]) / members
        mean_reference = (sums[:, 2] + self.reference[seed]) / members
        poses = np.empty((len(starts), 6))
        plane = poses[:, :4].view(np.complex128)
        plane[:, 0] = rotation
        plane[:, 1] = mean_reference - rotation * mean_query
        poses[:, 4] = (sums[:, 3].real + self.rise[seed]) / members
        poses[:, 5] = 1.0
        return poses, leading
