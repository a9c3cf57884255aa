"""What viewers hold of a drive."""

import numpy as np
import pytest
from foxglove_schemas_protobuf.PointCloud_pb2 import PointCloud
from foxglove_schemas_protobuf.SceneUpdate_pb2 import SceneUpdate

from logs.reader import LogReader
from slam.common.config import Config
from slam.display.map_topics import CLOSURES, LANDMARK_POINTS, LANDMARKS, PATH, SUBMAP
from slam.library import read_map
from slam.replay import replay
from tests.helpers.loop_drives import one_block, replay_drive
from tests.helpers.short_drives import drive, write_log


def points_of(cloud: PointCloud) -> np.ndarray:
    """Positions (N, 3): the first three fields, as its description has it."""
    rows = np.frombuffer(cloud.data, np.uint8).reshape(-1, cloud.point_stride)
    return np.ascontiguousarray(rows[:, :12]).view("<f4")


@pytest.mark.slow
def test_viewer_holds_more_of_the_map_as_the_drive_goes_and_all_at_the_end(tmp_path):
    mapped = tmp_path / "map.mcap"
    replay(write_log(tmp_path / "drive.mcap", drive()), mapped, Config(calibrate=False))
    with LogReader(mapped) as reader:
        clouds = [points_of(PointCloud.FromString(raw.data)) for raw in reader.messages([LANDMARK_POINTS])]
        paths = [SceneUpdate.FromString(raw.data).entities[0].lines[0].points for raw in reader.messages([PATH])]
        (markers,) = reader.messages([LANDMARKS])
    final = read_map(mapped)
    confirmed = final.positions[[state == "confirmed" for state in final.states]]
    assert len(clouds) > 10
    assert 0 < len(clouds[len(clouds) // 2]) < len(clouds[-1])
    assert len(paths[len(paths) // 2]) < len(paths[-1])
    np.testing.assert_allclose(clouds[-1], confirmed, atol=1e-4)
    assert len(SceneUpdate.FromString(markers.data).entities) == len(confirmed)


@pytest.mark.slow
def test_messages_hold_submap_path_and_closures(tmp_path):
    outcome = replay_drive(tmp_path, one_block())
    with LogReader(outcome.path) as reader:
        topics = (LANDMARK_POINTS, SUBMAP, PATH, CLOSURES)
        points, submaps, paths, closures = ([*reader.messages([topic])] for topic in topics)
    inside = [
        {*map(tuple, points_of(PointCloud.FromString(part.data)).tolist())}
        < {*map(tuple, points_of(PointCloud.FromString(whole.data)).tolist())}
        for part, whole in zip(submaps, points, strict=True)
    ]
    assert np.mean(inside) > 0.5
    assert max(len(each.data) for each in submaps) > 200
    path, lines = (SceneUpdate.FromString(raw.data).entities[0].lines for raw in (paths[-1], closures[-1]))
    assert len(path) == 1
    assert len(lines) == outcome.closures["accepted_count"] > 0
