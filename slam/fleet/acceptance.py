"""Which maps are joined: a place of one has to be recognised in the other beyond doubt.

The log odds of a :class:`Join` are those of a loop closure: the log-likelihood ratio of its landmarks, the prior of a
pose anywhere in the maps, and the rival poses of the place. Two maps are joined if they are wrong with a probability
below ``localization.error_probability``, shared among all pairs of maps: a false join bends everything on both sides.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.special import logit

from slam.common.config import Config
from slam.fleet.joins import Join


@dataclass(frozen=True, slots=True, eq=False)
class MapPair:
    """Two maps, ``first`` < ``second``, the ``joins`` between them, and the ``reason`` why these are not accepted."""

    first: int
    second: int
    joins: tuple[Join, ...]
    reason: str

    @property
    def accepted(self) -> bool:
        """Whether the maps are joined."""
        return not self.reason

    @property
    def surest(self) -> Join:
        """The join with the highest log odds."""
        return max(self.joins, key=lambda join: join.log_odds)


def judge_pairs(map_count: int, joins: Sequence[Join], config: Config) -> list[MapPair]:
    """One decision for each pair of ``map_count`` maps of which a place was recognised in the other."""
    of_pair = defaultdict[tuple[int, int], list[Join]](list)
    for join in joins:
        of_pair[join.reference_map, join.query_map].append(join)
    pairs = map_count * (map_count - 1) // 2
    min_log_odds = float(np.log(max(pairs, 1))) - float(logit(config.localization.error_probability))
    judged = []
    for (first, second), each in sorted(of_pair.items()):
        log_odds = max(join.log_odds for join in each)
        doubt = f"posterior log odds {log_odds:.1f}, less than {min_log_odds:.1f}"
        judged.append(MapPair(first, second, tuple(each), doubt if log_odds < min_log_odds else ""))
    return judged
