"""Places of one map localized in earlier ones, as single scans are.

One index has all maps, so the time of a query does not grow with their number.
"""

from __future__ import annotations

import json
from collections import defaultdict
from collections.abc import Iterator, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np

from logs.messages import ObjectDetections
from logs.storage.placement import write_text
from slam.common.arrays import FloatArray, IntArray
from slam.common.config import Config
from slam.common.geometry import apply, invert
from slam.fleet.condensed_map import place_landmarks
from slam.loop_closure.candidate import Candidate, suppress_non_maxima
from slam.object_map.map_io import SavedMap
from slam.scan_localization import ScanLocalizer


@dataclass(frozen=True, slots=True, eq=False)
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


class PlaceIndex:
    """The landmarks of condensed maps, numbered in their order."""

    def __init__(self, maps: Sequence[SavedMap], config: Config) -> None:
        self._first_rows = np.cumsum([0, *(len(saved.objects.ids) for saved in maps)])
        self._sensor_range_m = config.sensor_range_m
        # Where many maps overlap, a few of them suffice to join a place to all.
        closing = config.loop_closure.model_copy(update={"max_candidates": 8})
        config = config.model_copy(update={"loop_closure": closing})
        self._localizer = ScanLocalizer([saved.objects for saved in maps], config)

    def find_joins(self, query_map: SavedMap) -> list[Join]:
        """Where places of the next map are, likelier than not, in those of the index."""
        places = range(len(query_map.graph.keyframe_ids))
        return [join for place in places for join in self._localize(query_map, place) if join.log_odds > 0.0]

    def _localize(self, query_map: SavedMap, place: int) -> Iterator[Join]:
        """The likeliest pose of a place in each map."""
        seen, T_query_place = place_landmarks(query_map, place), query_map.graph.T_map_body[place]
        positions = apply(invert(T_query_place), query_map.objects.positions[seen])
        labels = tuple(query_map.objects.labels[row] for row in seen.tolist())
        query = self._localizer.query(ObjectDetections(0, "place", positions, labels, np.ones(len(seen))))
        in_map = defaultdict[int, list[Candidate]](list)
        for each in self._localizer.propose(query):
            if isinstance(each, Candidate):
                in_map[each.reference.odometry.segment].append(each)
        for number, candidates in in_map.items():
            best, *rivals = suppress_non_maxima(candidates, sensor_range_m=self._sensor_range_m)
            log_rivals = np.logaddexp.reduce([0.0, *(each.score for each in rivals)])
            queries, references = best.pairs.T
            yield Join(
                query_map=len(self._first_rows) - 1,
                reference_map=number,
                place=place,
                T_query_place=T_query_place,
                T_reference_place=best.T_local_query,
                covariance=best.covariance,
                log_odds=float(best.score - log_rivals - np.log(len(query_map.graph.keyframe_ids))),
                pairs=np.column_stack([seen[queries - self._first_rows[-1]], references - self._first_rows[number]]),
            )
