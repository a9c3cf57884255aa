"""A robot whose sensor sees 1.5 m or 600 m is mapped like one that sees 30 m, scaled."""

from collections.abc import Iterable
from dataclasses import dataclass, replace
from operator import attrgetter
from typing import Any

import numpy as np
import pytest

from logs.messages import DetectionAssociations, LoopClosureRecord, ObjectDetections, Odometry, Record, Transform
from slam.common.arrays import FloatArray
from slam.common.config import Config
from slam.final_map import FinalMap
from slam.object_map.map_io import SavedMap, load_map, save_map
from slam.system import Slam
from tests.helpers.loop_drives import SLOW, emptier, one_block
from tests.helpers.scaled_settings import scaled_config
from tests.helpers.short_drives import Entry, drive

pytestmark = pytest.mark.slow

SCALES = (0.05, 20.0)
DECISION = attrgetter("query_keyframe_id", "reference_keyframe_id", "stage", "inserted", "inlier_count", "proposer")


def scaled_pose(T: FloatArray, scale: float) -> FloatArray:
    result = T.copy()
    result[..., :3, 3] *= scale
    return result


def scaled(record: Record, scale: float) -> Record:
    """An input of the estimator with all its lengths scaled."""
    match record:
        case Odometry():
            return replace(record, T_odom_body=scaled_pose(record.T_odom_body, scale))
        case Transform():
            return replace(record, T_parent_child=scaled_pose(record.T_parent_child, scale))
        case ObjectDetections():
            return replace(record, positions=record.positions * scale, covariances=record.covariances * scale**2)
        case _:
            return record


@dataclass(frozen=True, slots=True)
class Result:
    """What the estimator says of a drive."""

    associations: list[tuple[int, tuple[str, ...]]]
    closures: list[tuple[Any, ...]]
    final: FinalMap


def mapped(entries: Iterable[Entry], scale: float, prior_map: SavedMap | None = None, *, extend: bool = True) -> Result:
    """The result for a drive whose lengths, and those of the settings, are scaled."""
    slam = Slam(Config.model_validate(scaled_config(Config(), scale)), prior_map, extend=extend)
    made = [update for _, _, record in entries for update in slam.process(scaled(record, scale))]
    final = slam.finish()
    return Result(
        [(each.stamp_ns, each.landmark_ids) for each in made if isinstance(each, DetectionAssociations)],
        [DECISION(each) for each in made if isinstance(each, LoopClosureRecord)],
        final,
    )


@pytest.fixture(scope="module")
def entries() -> list[Entry]:
    """Around a block and one street of it again, with the default noise."""
    return drive(SLOW, world=one_block())


@pytest.fixture(scope="module")
def results(entries) -> dict[float, Result]:
    """Of that drive at each scale."""
    return {scale: mapped(entries, scale) for scale in (1.0, *SCALES)}


@pytest.mark.parametrize("scale", SCALES)
def test_a_scaled_drive_has_the_scaled_map(results, scale):
    assert sum(stage == "accepted" for _, _, stage, *_ in results[1.0].closures) > 10
    _assert_alike(results[scale], results[1.0], scale)


@pytest.fixture(scope="module")
def maps(results, tmp_path_factory) -> dict[float, SavedMap]:
    loaded = {}
    for scale, result in results.items():
        path = tmp_path_factory.mktemp("maps") / "map.mcap"
        save_map(path, result.final.object_map, result.final.graph, {"version": "0", "input_sha256": "0"})
        loaded[scale] = load_map(path)
    return loaded


@pytest.mark.parametrize(("scale", "extend"), [(0.05, True), (20.0, False)])
def test_a_robot_finds_itself_in_a_scaled_map(maps, scale, extend):
    """Some objects are gone, so that what is expected in view is not all seen."""
    again = drive(SLOW, seed=2, world=emptier(one_block()))
    expected = mapped(again, 1.0, maps[1.0], extend=extend)
    assert expected.final.status.counters["relocalizations"] > 0
    _assert_alike(mapped(again, scale, maps[scale], extend=extend), expected, scale)


def _assert_alike(result: Result, unscaled: Result, scale: float) -> None:
    assert result.associations == unscaled.associations
    assert result.closures == unscaled.closures
    expected, final = unscaled.final, result.final
    np.testing.assert_array_equal(final.graph.keyframe_ids, expected.graph.keyframe_ids)
    np.testing.assert_array_equal(final.graph.keyframe_stamps_ns, expected.graph.keyframe_stamps_ns)
    assert final.object_map.ids == expected.object_map.ids
    assert final.object_map.states == expected.object_map.states
    extent_m = np.ptp(expected.trajectory.T_map_body[:, :2, 3], axis=0).max()
    np.testing.assert_allclose(
        final.trajectory.T_map_body[:, :3, 3] / scale,
        expected.trajectory.T_map_body[:, :3, 3],
        rtol=0.0,
        atol=1e-3 * extent_m,
    )
    np.testing.assert_allclose(
        final.object_map.positions / scale, expected.object_map.positions, rtol=0.0, atol=1e-3 * extent_m
    )
