"""What viewers hold of a drive."""

import numpy as np
import pytest
from foxglove_schemas_protobuf.PointCloud_pb2 import PointCloud
from foxglove_schemas_protobuf.SceneUpdate_pb2 import SceneUpdate

from slam.display.map_topics import CLOSURES, LANDMARK_POINTS, LANDMARKS, PATH, SUBMAP
from slam.library import read_map
from tests.helpers.loop_drives import one_block, replay_drive
from tests.helpers.short_drives import raw_messages


def points_of(cloud: PointCloud) -> np.ndarray:
    """Positions (N, 3): the first three fields, as its description has it."""
    rows = np.frombuffer(cloud.data, np.uint8).reshape(-1, cloud.point_stride)
    return np.ascontiguousarray(rows[:, :12]).view("<f4")


@pytest.mark.slow
def test_viewer_holds_more_of_the_map_as_the_drive_goes_and_all_at_the_end(tmp_path):
    outcome = replay_drive(tmp_path, one_block())
    clouds, submaps = (
        [points_of(PointCloud.FromString(raw.data)) for raw in raw_messages(outcome.path, topic)]
        for topic in (LANDMARK_POINTS, SUBMAP)
    )
    paths, closures, (markers,) = (
        [SceneUpdate.FromString(raw.data).entities for raw in raw_messages(outcome.path, topic)]
        for topic in (PATH, CLOSURES, LANDMARKS)
    )
    final = read_map(outcome.path)
    confirmed = final.positions[[state == "confirmed" for state in final.states]]
    assert len(clouds) > 10
    assert 0 < len(clouds[len(clouds) // 2]) < len(clouds[-1])
    np.testing.assert_allclose(clouds[-1], confirmed, atol=1e-4)
    assert len(markers) == len(confirmed)
    inside = [{*map(tuple, part)} < {*map(tuple, whole)} for part, whole in zip(submaps, clouds, strict=True)]
    assert np.mean(inside) > 0.5
    (path,), (earlier,) = paths[-1][0].lines, paths[len(paths) // 2][0].lines
    assert len(earlier.points) < len(path.points)
    assert len(closures[-1][0].lines) == outcome.closures["accepted_count"] > 0
