"""Places of one map localized in earlier ones, as single scans are, and the maps that are joined by them.

One index has all earlier maps, so the time of a query does not grow with their number.
"""

import json
from collections import defaultdict
from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np
from scipy.special import logit

from logs.messages import ObjectDetections
from logs.records import frozen
from logs.storage.placement import write_text
from slam.common.arrays import FloatArray, IntArray
from slam.common.config import Config
from slam.common.geometry import apply, invert
from slam.fleet.condensed_map import place_landmarks
from slam.loop_closure.candidate import Candidate, suppress_non_maxima
from slam.object_map.map_io import SavedMap
from slam.scan_localization import ScanLocalizer


@frozen
class Join:
    """A place of map ``query_map`` recognised in the earlier map ``reference_map``.

    ``T_query_place``, ``T_reference_place`` (4, 4): the place in the frames of the two maps, the latter with its
    ``covariance`` (6, 6), rotation first; ``log_odds``: of the same place against all other poses and against chance
    [nats]; ``pairs`` (P, 2): rows of the landmarks of the two maps that were matched.
    """

    query_map: int
    reference_map: int
    place: int
    T_query_place: FloatArray
    T_reference_place: FloatArray
    covariance: FloatArray
    log_odds: float
    pairs: IntArray

    @property
    def maps(self) -> tuple[int, int]:
        """The two maps, the reference first."""
        return self.reference_map, self.query_map

    @property
    def T_reference_query(self) -> FloatArray:
        """The transform (4, 4) between the two maps that it implies."""
        return self.T_reference_place @ invert(self.T_query_place)


def write_joins(path: Path, joins: Sequence[Join]) -> None:
    """Write joins as JSON.

    Raises:
        UnwritableLogError: the file cannot be written.
    """
    write_text(path, json.dumps([asdict(join) for join in joins], default=np.ndarray.tolist))


def read_joins(path: Path) -> list[Join]:
    """The joins that :func:`write_joins` wrote."""
    values: list[dict[str, Any]] = json.loads(path.read_text(encoding="utf-8"))
    arrays = "T_query_place", "T_reference_place", "covariance", "pairs"
    return [Join(**{**each, **{name: np.array(each[name]) for name in arrays}}) for each in values]


def find_joins(query_map: SavedMap, references: Sequence[SavedMap], config: Config) -> list[Join]:
    """Where places of a map are, likelier than not, in condensed maps before it, which are numbered in their order."""
    first_rows = np.cumsum([0, *(len(saved.objects.ids) for saved in references)])
    # Where many maps overlap, a few of them suffice to join a place to all.
    config = config.closing(max_candidates=8)
    localizer = ScanLocalizer([saved.objects for saved in references], config)
    places = len(query_map.graph.keyframe_ids)
    joins = []
    for place in range(places):
        seen, T_query_place = place_landmarks(query_map, place), query_map.graph.T_map_body[place]
        positions = apply(invert(T_query_place), query_map.objects.positions[seen])
        labels = tuple(query_map.objects.labels[row] for row in seen.tolist())
        query = localizer.query(ObjectDetections(0, "place", positions, labels, np.ones(len(seen))))
        in_map = defaultdict[int, list[Candidate]](list)
        for each in localizer.propose(query):
            if isinstance(each, Candidate):
                in_map[each.reference.odometry.segment].append(each)
        for number, candidates in in_map.items():
            best, *rivals = suppress_non_maxima(candidates, config.sensor_range_m)
            log_rivals = np.logaddexp.reduce([0.0, *(each.score for each in rivals)])
            queries, rows = best.pairs.T
            join = Join(
                query_map=len(references),
                reference_map=number,
                place=place,
                T_query_place=T_query_place,
                T_reference_place=best.T_local_query,
                covariance=best.covariance,
                log_odds=float(best.score - log_rivals - np.log(places)),
                pairs=np.column_stack([seen[queries - first_rows[-1]], rows - first_rows[number]]),
            )
            joins += [join] if join.log_odds > 0.0 else []
    return joins


def accept_joins(joins: Sequence[Join], map_count: int, config: Config) -> list[Join]:
    """All joins of each two maps that the surest of them joins."""
    limit = _min_log_odds(map_count, config)
    joined = {join.maps for join in joins if join.log_odds >= limit}
    return [join for join in joins if join.maps in joined]


def why_alone(number: int, joins: Sequence[Join], map_count: int, config: Config) -> str:
    """The reason why the map ``number`` of so many was joined with no other one."""
    own = [join.log_odds for join in joins if number in join.maps]
    if not own:
        return "none of its places was recognised in another log"
    best, limit = max(own), _min_log_odds(map_count, config)
    doubt = f"posterior log odds {best:.1f}, less than {limit:.1f}"
    return doubt if best < limit else "its joins contradict those of other logs"


def _min_log_odds(map_count: int, config: Config) -> float:
    """The least log odds by which two of so many maps are joined: they are wrong with a probability below
    ``localization.error_probability``, shared among all pairs of maps, as a false join bends everything on both sides.
    """
    pairs = map_count * (map_count - 1) // 2
    return float(np.log(max(pairs, 1))) - float(logit(config.localization.error_probability))
