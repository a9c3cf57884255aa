"""Where accepted closures come from: found by retrieval, followed from the closure before, or led back to.

A closure that retrieval found is a discovery; those that it predicts for the keyframes after it and before it are
checks of the same discovery. So a precision is as sure as its discoveries are many, and these only count as several
where they have no objects in common.
"""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass, field

import numpy as np
from scipy.special import betaincinv

from slam.evaluation.inputs.protocol import Protocol
from slam.evaluation.place_recognition.closure_labels import JudgedClosures

CONFIDENCE = 0.95


@dataclass(frozen=True, slots=True)
class Discoveries:
    """Accepted closures by their origin: found, followed forwards, led back to keyframes before.

    ``independent_count``: found closures in runs, a run ending where the next query is a submap's length further on,
    and of these ``independent_false_count``, runs with a false one. Both None without truth. ``proposer_counts``:
    accepted closures by who proposed their place; none in logs of earlier versions.
    """

    found_count: int
    followed_count: int
    led_back_count: int
    independent_count: int | None
    independent_false_count: int | None
    proposer_counts: dict[str, int] = field(default_factory=dict)

    @property
    def descriptor_verdict(self) -> str | None:
        """What the descriptor decided, in words; None where nothing was retrieved, or nobody wrote who proposed it."""
        if not self.proposer_counts or not self.found_count:
            return None
        count = self.proposer_counts.get("descriptor", 0)
        return (
            f"{count} proposed by the descriptor" if count else "none proposed by the descriptor, which decided nothing"
        )

    @property
    def largest_false_share(self) -> float | None:
        """No more than that share of discoveries is false, with 95 % confidence (Clopper and Pearson, Biometrika 1934).

        About 3 / n where none of n is false: the rule of three. None without truth or discovery.
        """
        if self.independent_count is None or self.independent_false_count is None or self.independent_count == 0:
            return None
        if self.independent_false_count == self.independent_count:
            return 1.0
        right = self.independent_count - self.independent_false_count
        return float(betaincinv(self.independent_false_count + 1, right, CONFIDENCE))


def count_discoveries(judged: JudgedClosures, protocol: Protocol, *, has_truth: bool) -> Discoveries:
    """Count the accepted closures of a drive by their origin."""
    rows = np.flatnonzero(judged.accepted)
    queries = judged.query_ids[rows]
    seeds = [judged.candidates[row].seed_query_keyframe_id for row in rows.tolist()]
    proposers = [judged.candidates[row].proposer for row in rows.tolist() if judged.candidates[row].proposer]
    is_found = np.array([seed is None for seed in seeds], dtype=np.bool_)
    is_followed = np.array(
        [seed is not None and seed < query for seed, query in zip(seeds, queries.tolist(), strict=True)], dtype=np.bool_
    )
    independent = independent_false = None
    if has_truth:
        found = rows[is_found & judged.decided[rows]]
        found = found[np.argsort(judged.travelled_m[found], kind="stable")]
        runs = np.cumsum(np.diff(judged.travelled_m[found], prepend=-np.inf) >= protocol.window_m)
        independent = len(np.unique(runs))
        independent_false = len(np.unique(runs[~judged.true[found]]))
    return Discoveries(
        found_count=int(is_found.sum()),
        followed_count=int(is_followed.sum()),
        led_back_count=int((~is_found & ~is_followed).sum()),
        independent_count=independent,
        independent_false_count=independent_false,
        proposer_counts=dict(sorted(Counter(proposers).items())),
    )
