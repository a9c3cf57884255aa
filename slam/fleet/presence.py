"""When each landmark of a joint map stood there: appeared, present, gone, with probabilities and dates.

A landmark is not there yet, then there, then gone: a hidden Markov chain over the sessions in the order of their
dates, with one hazard for both changes (Rabiner, Proceedings of the IEEE 1989, for the forward and backward passes).
A session says something of a landmark only where it passed: it saw it, or it missed it although it would have been seen
with the probability of its distance from the path, which is learned from the fleet. The hazard is estimated from all
landmarks by expectation maximisation, so that a fleet in which nothing changes reports no changes.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from slam.common.arrays import BoolArray, FloatArray, IntArray

NOT_YET, PRESENT, GONE = 0, 1, 2
FALSE_SIGHTING = 1e-3
"""Probability that a session has a landmark where none stands any more."""
DISTANCES = 12
"""Cells of the distance from the path."""
PRIOR_PASSED, PRIOR_SEEN = 2.0, 1.0
"""What is assumed of a cell before anything was seen there."""
ITERATIONS = 30
LEAST_DAYS = 1.0
"""Sessions of one day are taken to be that far apart."""
FIRST_CHANGES = 0.1
"""Changes of a landmark over the time of the fleet that the estimate of the hazard begins with."""


@dataclass(frozen=True, slots=True, eq=False)
class Presence:
    """Of L landmarks over M sessions, in the order of their dates.

    ``states`` (L, M, 3): probability that it is not there yet, there, and gone, when the session passed;
    ``changed`` (L, M - 1, 2): that it appeared, and that it went, between one session and the next;
    ``hazard_per_day``: of either change.
    """

    states: FloatArray
    changed: FloatArray
    hazard_per_day: float

    @property
    def appeared(self) -> FloatArray:
        """Probability (L,) that it was not there when the fleet began."""
        return np.asarray(self.states[:, 0, NOT_YET])

    @property
    def gone(self) -> FloatArray:
        """Probability (L,) that it is gone by the last session."""
        return np.asarray(self.states[:, -1, GONE])

    @property
    def present(self) -> FloatArray:
        """Probability (L,) that it is there at the last session."""
        return np.asarray(self.states[:, -1, PRESENT])


def seen_probabilities(seen: BoolArray, distances_m: FloatArray) -> FloatArray:
    """Probability (L, M) that a session sees a landmark that is there; 0 where it did not pass.

    Learned from landmarks that an earlier and a later session saw, so that they certainly stood there.

    Args:
        seen: (L, M), sessions in the order of their dates.
        distances_m: (L, M) from the path of the session.
    """
    if not seen.any():
        return np.zeros(seen.shape)
    reach_m = float(np.quantile(distances_m[seen], 0.99))
    cells = np.minimum((distances_m / reach_m * DISTANCES).astype(np.int64), DISTANCES)
    before = np.cumsum(seen, axis=1) - seen > 0
    after = np.cumsum(seen[:, ::-1], axis=1)[:, ::-1] - seen > 0
    certain = before & after
    passed = np.bincount(cells[certain], minlength=DISTANCES + 1)[: DISTANCES + 1] + PRIOR_PASSED
    met = np.bincount(cells[certain & seen], minlength=DISTANCES + 1)[: DISTANCES + 1] + PRIOR_SEEN
    share = met / passed
    share[DISTANCES] = 0.0
    probabilities = share[cells]
    # What was seen was in view, however far.
    return np.where(seen, np.maximum(probabilities, PRIOR_SEEN / PRIOR_PASSED), probabilities)


def estimate_presence(seen: BoolArray, probabilities: FloatArray, stamps_ns: IntArray) -> Presence:
    """The states of all landmarks.

    Args:
        seen: (L, M) sightings.
        probabilities: (L, M) that it would have been seen, if it was there.
        stamps_ns: (M,) of the sessions, ascending.
    """
    days = np.diff(stamps_ns) / 86_400e9
    span = max(float(days.sum()), LEAST_DAYS)
    there = np.where(seen, probabilities, 1.0 - probabilities)
    absent = np.where(seen, FALSE_SIGHTING, 1.0)
    likelihoods = np.stack([absent, there, absent], axis=2)
    hazard = FIRST_CHANGES / span
    for _ in range(ITERATIONS):
        states, changed = _smooth(likelihoods, days, hazard)
        there_days = states[:, :-1, PRESENT] @ days
        hazard = (0.5 * float(changed.sum()) + FIRST_CHANGES) / (float(there_days.sum()) + span)
    states, changed = _smooth(likelihoods, days, hazard)
    return Presence(states, changed, hazard)


def _smooth(likelihoods: FloatArray, days: FloatArray, hazard: float) -> tuple[FloatArray, FloatArray]:
    """Posterior of the states (L, M, 3) and of the changes between two sessions (L, M - 1, 2)."""
    count, sessions, _ = likelihoods.shape
    # What is to appear does so at any time: by the last session all that the map has stood there once.
    left = np.cumsum(days[::-1])[::-1]
    steps = [
        _transition(each / max(rest, 1e-12), -np.expm1(-hazard * each))
        for each, rest in zip(days.tolist(), left.tolist(), strict=True)
    ]
    begins = -np.expm1(-hazard * float(days.sum()))
    forward = np.zeros((count, sessions, 3))
    forward[:, 0] = np.array([begins, 1.0 - begins, 0.0]) * likelihoods[:, 0]
    forward[:, 0] /= forward[:, 0].sum(axis=1, keepdims=True)
    for k, step in enumerate(steps, start=1):
        forward[:, k] = forward[:, k - 1] @ step * likelihoods[:, k]
        forward[:, k] /= forward[:, k].sum(axis=1, keepdims=True)
    backward = np.ones((count, sessions, 3))
    changed = np.zeros((count, sessions - 1, 2))
    for k in range(sessions - 2, -1, -1):
        ahead = likelihoods[:, k + 1] * backward[:, k + 1]
        joint = forward[:, k, :, None] * steps[k] * ahead[:, None, :]
        joint /= joint.sum(axis=(1, 2), keepdims=True)
        changed[:, k, 0] = joint[:, NOT_YET, PRESENT] + joint[:, NOT_YET, GONE]
        changed[:, k, 1] = joint[:, PRESENT, GONE] + joint[:, NOT_YET, GONE]
        backward[:, k] = ahead @ steps[k].T
        backward[:, k] /= backward[:, k].sum(axis=1, keepdims=True)
    states = forward * backward
    return states / states.sum(axis=2, keepdims=True), changed


def _transition(appears: float, goes: float) -> FloatArray:
    """Probabilities (3, 3) of the states at the next session, in which it appears or goes with those probabilities."""
    return np.array(
        [[1.0 - appears, appears * (1.0 - 0.5 * goes), 0.5 * appears * goes], [0.0, 1.0 - goes, goes], [0.0, 0.0, 1.0]]
    )
