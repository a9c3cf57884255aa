"""Several saved maps as one, in the frame of the first: places of one are recognised in others, and all is joined."""

from __future__ import annotations

import logging
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import combinations

import numpy as np

from slam.common.config import Config
from slam.common.errors import SavedMapError
from slam.common.geometry import covariance_in_axes, invert
from slam.common.union_find import UnionFind
from slam.map_joining.acceptance import MapPair, judge_pairs
from slam.map_joining.condensed_map import condense_map, place_rows, stretch_length_m
from slam.map_joining.joins import Join, find_joins
from slam.map_joining.joint_map import join_maps
from slam.map_joining.place_index import make_place_index
from slam.map_joining.session_config import common_config
from slam.object_map.map_io import SavedMap
from slam.odometry.noise import BREAK_SIGMA_RAD, BREAK_SIGMA_RANGES

logger = logging.getLogger(__name__)


@dataclass(frozen=True, slots=True, eq=False)
class MergedMap:
    """A map in the frame of the first of several.

    ``recognised``: places of each map (M,) that were recognised in another one; ``shared``: landmarks that were in more
    than one map; ``repeated``: inputs (sha256) that went into more than one map, and count more than once.
    """

    saved: SavedMap
    recognised: tuple[int, ...]
    shared: int
    repeated: tuple[str, ...]


def merge_maps(maps: Sequence[SavedMap]) -> MergedMap | list[int]:
    """Join maps by recognising places of one in another, or else by the georeferences of both.

    Returns:
        The joined map; or the numbers of the maps that nothing relates to the others.
    """
    config = _configuration(maps)
    recognised = _recognised_pairs(maps, config)
    pairs = [*recognised, *_georeferenced_pairs(maps, recognised, config)]
    (joint, *others) = join_maps(dict(enumerate(maps)), pairs, config)
    if others:
        return sorted(number for part in others for number in part.members)
    last = maps[-1]
    metadata = {key: text for key, text in last.metadata.items() if key != "georeference"}
    if "georeference" in maps[0].metadata:
        metadata["georeference"] = maps[0].metadata["georeference"]
    drives = tuple(drive for each in maps for drive in each.drives)
    inputs = Counter(drive.get("input_sha256", "") for drive in drives)
    found = Counter(join.query_map for pair in recognised for join in pair.joins)
    return MergedMap(
        saved=SavedMap(joint.objects, joint.graph, metadata, drives),
        recognised=tuple(found[number] for number in range(len(maps))),
        shared=len(joint.sightings) - len(joint.objects.ids),
        repeated=tuple(sha256 for sha256, count in inputs.items() if sha256 and count > 1),
    )


def _configuration(maps: Sequence[SavedMap]) -> Config:
    """The one by which the maps are compared; the default one if a map has settings that there are no longer."""
    try:
        return common_config(each.metadata for each in maps)
    except SavedMapError as error:
        logger.info("the default configuration is used: %s", error)
        return Config()


def _recognised_pairs(maps: Sequence[SavedMap], config: Config) -> list[MapPair]:
    """The pairs of maps that share places, with joins between keyframes."""
    stretch_m = stretch_length_m(config)
    condensed = [condense_map(each, stretch_m=stretch_m) for each in maps]
    rows = [place_rows(each, stretch_m=stretch_m).tolist() for each in maps]
    index = make_place_index(condensed, sigma_m=config.calibration.objects.landmark_sigma_m)
    joins = [join for number, each in enumerate(condensed) for join in find_joins(each, number, index, config)]

    def at_keyframe(join: Join) -> Join:
        row = rows[join.query_map][join.place]
        T_map_place = condensed[join.query_map].graph.T_map_body[join.place]
        T_place_body = invert(T_map_place) @ maps[join.query_map].graph.T_map_body[row]
        return replace(
            join,
            place=row,
            T_reference_place=join.T_reference_place @ T_place_body,
            covariance=covariance_in_axes(join.covariance, T_place_body[:3, :3]),
        )

    return [
        replace(pair, joins=tuple(map(at_keyframe, pair.joins)))
        for pair in judge_pairs(condensed, joins, config)
        if pair.accepted
    ]


def _georeferenced_pairs(maps: Sequence[SavedMap], recognised: Sequence[MapPair], config: Config) -> list[MapPair]:
    """As many pairs of georeferenced maps as it takes to relate those that share no place."""
    related, found = UnionFind(), list[MapPair]()
    for pair in recognised:
        related.merge(pair.first, pair.second)
    sigmas = np.repeat([BREAK_SIGMA_RAD, BREAK_SIGMA_RANGES * config.sensor_range_m], 3)
    for first, second in combinations(range(len(maps)), 2):
        here, there = maps[first].georeference, maps[second].georeference
        if here is None or there is None or not related.merge(first, second):
            continue
        T_first_body = here.T_map_other(there) @ maps[second].graph.T_map_body[0]
        join = Join(second, 0, first, T_first_body, np.diag(sigmas**2), llr=0.0, matched=0)
        found.append(MapPair(first, second, (join,), 0.0, True, ""))
    return found
