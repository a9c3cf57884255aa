from __future__ import annotations

from pathlib import Path

import numpy as np

from slam.common.config import Config
from slam.map_joining.acceptance import judge_pairs
from slam.map_joining.condensed_map import condense_map
from slam.map_joining.joins import find_joins
from slam.map_joining.joint_map import join_parts
from slam.map_joining.part import Part, are_saved, fold_part, load_parts, save_parts, saved_parts, session_part
from slam.map_joining.place_index import make_place_index
from tests.helpers.driven_maps import driven_map, town

CONFIG, STRETCH_M = Config(), 25.0
DRIVES = ((0.0, 200.0), (50.0, 250.0), (150.0, 0.0))


def joined(parts: list[Part]) -> list[Part]:
    maps = [part.saved for part in parts]
    index = make_place_index(maps, sigma_m=CONFIG.calibration.objects.landmark_sigma_m)
    joins = [join for number, each in enumerate(maps) for join in find_joins(each, number, index, CONFIG)]
    return join_parts(parts, judge_pairs(maps, joins, CONFIG, penalty=6.0), CONFIG)


def sessions() -> list[Part]:
    maps = [driven_map(town(), *drive, seed=seed) for seed, drive in enumerate(DRIVES)]
    return [session_part(number, condense_map(each, stretch_m=STRETCH_M)) for number, each in enumerate(maps)]


def test_a_folded_part_is_joined_as_its_sessions_would_be(tmp_path: Path) -> None:
    first, second, third = sessions()
    (both,) = joined([first, second])
    save_parts(tmp_path, [fold_part(both, stretch_m=STRETCH_M)])
    assert are_saved(tmp_path)
    assert len(saved_parts(tmp_path)) == 1
    (folded,) = load_parts(tmp_path)
    (late,), (whole,) = joined([folded, third]), joined([first, second, third])
    assert late.sessions == whole.sessions == (0, 1, 2)
    assert len(late.objects.ids) == len(whole.objects.ids)
    assert sorted(late.seen.values()) == sorted(whole.seen.values())
    for number, path in whole.paths.items():
        np.testing.assert_allclose(late.paths[number][..., :2], path[..., :2], atol=0.05)


def test_a_folded_part_has_the_places_of_its_area_and_not_of_each_session() -> None:
    parts = sessions()
    (part,) = joined(parts)
    folded = fold_part(part, stretch_m=STRETCH_M).saved.graph
    assert len(part.saved.graph.keyframe_ids) == sum(len(each.saved.graph.keyframe_ids) for each in parts)
    assert len(folded.keyframe_ids) <= 250.0 / STRETCH_M + 1
