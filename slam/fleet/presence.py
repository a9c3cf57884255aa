"""When each landmark of a joint map stood there: appeared, present, gone, with probabilities and dates.

A landmark is not there yet, then there, then gone: a hidden Markov chain over the sessions in the order of their
dates, with one hazard for both changes (Rabiner, Proceedings of the IEEE 1989, for the forward and backward passes).
A session is evidence about a landmark only where it passed: it observed the landmark, or missed it although it would
have observed it with a probability that is learned from the fleet, by its distance from the path.

Landmarks differ: one of two signs beside each other has a landmark of its own in the maps of few sessions only. Each
landmark has a detectability, the factor of that probability, constant in time, whose distribution is estimated from the
fleet (MacKenzie et al., Occupancy Estimation and Modeling, chapter 4: detection that differs from site to site). So
landmarks of few among many sessions are not reported as changes. The hazard, too, is estimated from all landmarks,
by expectation maximisation, so that a fleet in which nothing changes reports no changes.
"""

from collections.abc import Sequence

import numpy as np

from logs.records import frozen
from slam.common.arrays import BoolArray, FloatArray, IntArray
from slam.fleet.part import Part

NOT_YET, PRESENT, GONE = 0, 1, 2
REPORTED = 0.5
"""States and changes of at least that probability are reported."""
CELLS = 12
"""Cells of the distance, with equal numbers of sightings."""
DETECTABILITIES = 0.5 ** np.arange(7)
"""Down to one sighting in 64 passes; what is seen more rarely says nothing."""
PRIOR_PASSED, PRIOR_SEEN = 2.0, 1.0
"""Passes and sightings that a cell is assumed to have had before."""


def find_passes(part: Part) -> tuple[BoolArray, FloatArray]:
    """Which landmarks each session of a part saw, and how far from them it passed [m]: (L, M) each."""
    landmarks = part.objects.positions[:, :2]
    visits = [part.visits[number] for number in part.sessions]
    seen = np.column_stack([np.isin(np.arange(len(landmarks)), visit.landmarks) for visit in visits])
    return seen, np.column_stack([_distances_m(landmarks, visit.steps[:, :, :2]) for visit in visits])


def _distances_m(points: FloatArray, steps: FloatArray) -> FloatArray:
    """Distances (N,) m of points (N, 2) from a path of steps (S, 2, 2)."""
    ways = steps[:, 1] - steps[:, 0]
    offsets = points[:, None] - steps[:, 0]
    along = np.einsum("nsi,si->ns", offsets, ways) / np.maximum(np.einsum("si,si->s", ways, ways), 1e-12)
    return np.linalg.norm(offsets - along.clip(0.0, 1.0)[..., None] * ways, axis=2).min(axis=1)


@frozen
class Presence:
    """Of L landmarks over M sessions, in the order of their dates.

    ``states`` (L, M, 3): probability that it is not there yet, there, and gone, when the session passed;
    ``detectability`` (L,): expected; ``hazard_per_day``: of either change.
    """

    states: FloatArray
    detectability: FloatArray
    hazard_per_day: float

    @property
    def changed(self) -> FloatArray:
        """Probability (L, M - 1, 2) that it appeared, and that it went, between one session and the next."""
        # It appears once and goes once.
        steps = np.diff(self.states, axis=1)
        return np.stack([-steps[..., NOT_YET], steps[..., GONE]], axis=-1)

    @property
    def appeared(self) -> FloatArray:
        """Probability (L,) that it was not there when the fleet began."""
        return self.states[:, 0, NOT_YET]

    @property
    def gone(self) -> FloatArray:
        """Probability (L,) that it is gone by the last session."""
        return self.states[:, -1, GONE]

    @property
    def present(self) -> FloatArray:
        """Probability (L,) that it is there at the last session."""
        return self.states[:, -1, PRESENT]

    @property
    def useful(self) -> FloatArray:
        """Probability (L,) that it is there at the last session and, where most objects would be, seen by the next."""
        return self.present * self.detectability


def seen_probabilities(seen: BoolArray, distances_m: FloatArray) -> FloatArray:
    """Probability (L, M) that a session sees a landmark that is there; 0 where it did not pass.

    By what :func:`find_passes` returns; learned from landmarks that an earlier and a later session saw, so that they
    certainly stood there; the sessions are in the order of their dates.
    """
    # Farther away than nearly all sightings nothing is in reach of the sensors.
    passed = distances_m <= np.quantile(distances_m[seen], 0.99)
    limits_m = np.quantile(distances_m[seen & passed], np.arange(1, CELLS) / CELLS)
    cells = np.searchsorted(limits_m, distances_m)
    before = np.cumsum(seen, axis=1) > seen
    after = np.cumsum(seen[:, ::-1], axis=1)[:, ::-1] > seen
    certain = before & after & passed
    opportunities = np.bincount(cells[certain], minlength=CELLS) + PRIOR_PASSED
    met = np.bincount(cells[certain & seen], minlength=CELLS) + PRIOR_SEEN
    probabilities = np.where(passed, (met / opportunities)[cells], 0.0)
    # A landmark that was seen was in view.
    return np.where(seen, np.maximum(probabilities, PRIOR_SEEN / PRIOR_PASSED), probabilities)


def estimate_presence(seen: BoolArray, probabilities: FloatArray, stamps_ns: Sequence[int] | IntArray) -> Presence:
    """The states of all landmarks.

    Args:
        seen: (L, M) sightings.
        probabilities: (L, M) that it would have been seen, if it was there and as well detectable as most.
        stamps_ns: (M,) of the sessions, ascending.
    """
    days = np.diff(np.array(stamps_ns) / 86_400e9)
    span = max(days.sum(), 1.0)  # sessions of one day
    first_changes = 0.1  # of a landmark over the time of the fleet, with which the estimate begins
    hazard = first_changes / span
    weights = np.full(len(DETECTABILITIES), 1.0 / len(DETECTABILITIES))
    for _ in range(12):
        states, shares = _average(seen, probabilities, days, hazard, weights)
        presence = Presence(states, shares @ DETECTABILITIES, hazard)
        there_days = (states[:, :-1, PRESENT] @ days).sum()
        hazard = (0.5 * presence.changed.sum() + first_changes) / (there_days + span)
        weights = (shares.sum(axis=0) + 1.0 / len(weights)) / (len(shares) + 1.0)
    return presence


def _average(
    seen: BoolArray, probabilities: FloatArray, days: FloatArray, hazard: float, weights: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Posterior of the states (L, M, 3) and of the detectabilities (L, D).

    A session has a landmark where none stands any more with a probability of one in a thousand.

    Args:
        seen: (L, M) sightings.
        probabilities: (L, M) that it would have been seen.
        days: (M - 1,) between sessions.
        hazard: of either change, a day.
        weights: (D,) prior of the detectabilities.
    """
    log_shares = []
    states, total = np.zeros(1), np.full(1, -np.inf)
    # A running average, as all posteriors at once would take much memory.
    for detectability, weight in zip(DETECTABILITIES.tolist(), weights.tolist(), strict=True):
        detected = detectability * probabilities
        log_ratios = np.log(np.where(seen, detected / 1e-3, 1.0 - detected))
        given, log_evidence = _smooth(log_ratios, days, hazard)
        log_shares.append(log_evidence + np.log(weight))
        total = np.logaddexp(total, log_shares[-1])
        states = states + np.exp(log_shares[-1] - total)[:, None, None] * (given - states)
    return states, np.exp(np.column_stack(log_shares) - total[:, None])


def _smooth(log_ratios: FloatArray, days: FloatArray, hazard: float) -> tuple[FloatArray, FloatArray]:
    """Posterior (L, M, 3) of the states by log-likelihood ratios (L, M), and log evidence (L,) against never there."""
    scales = np.maximum(log_ratios, 0.0)
    absent = np.exp(-scales)
    likelihoods = np.stack([absent, np.exp(log_ratios - scales), absent], axis=2)
    # A landmark that appears does so at any time: by the last session each has been present once.
    left = np.cumsum(days[::-1])[::-1]
    steps = [
        _transition(each / max(rest, 1e-12), -np.expm1(-hazard * each))
        for each, rest in zip(days.tolist(), left.tolist(), strict=True)
    ]
    begins = -np.expm1(-hazard * days.sum())
    forward, log_evidence = np.zeros_like(likelihoods), scales.sum(axis=1)
    predicted = np.array([begins, 1.0 - begins, 0.0])
    for k in range(likelihoods.shape[1]):
        forward[:, k] = (forward[:, k - 1] @ steps[k - 1] if k else predicted) * likelihoods[:, k]
        norms = forward[:, k].sum(axis=1)
        forward[:, k] /= norms[:, None]
        log_evidence += np.log(norms)
    states, backward = forward, np.ones((len(likelihoods), 3))
    for k in range(len(steps) - 1, -1, -1):
        backward = (likelihoods[:, k + 1] * backward) @ steps[k].T
        backward /= backward.sum(axis=1, keepdims=True)
        states[:, k] *= backward
    return states / states.sum(axis=2, keepdims=True), log_evidence


def _transition(appears: float, goes: float) -> FloatArray:
    """Probabilities (3, 3) of the states at the next session, in which it appears or goes with those probabilities."""
    return np.array(
        [[1.0 - appears, appears * (1.0 - 0.5 * goes), 0.5 * appears * goes], [0.0, 1.0 - goes, goes], [0.0, 0.0, 1.0]]
    )
