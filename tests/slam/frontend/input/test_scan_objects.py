"""Scans of a LiDAR whose points have classes are detections before they are mapped."""

import numpy as np
import pytest

from logs.messages import LabelledScan, ObjectDetections, Transform
from slam.common.config import Config
from slam.common.geometry import make_transform
from slam.frontend.input.input_records import InputRecords, ScanObjects
from slam.frontend.input.label_map import LabelMap
from slam.frontend.input.sensor_frames import SensorFrames
from tests.logs.clouds.clouds import FAR, cloud, post

LABELS = Config.model_validate({"labels": {"rename": {"80": "pole", "71": "trunk"}, "drop": ["10"]}}).labels
OPTICAL = np.array([[0.0, 0.0, 1.0], [-1.0, 0.0, 0.0], [0.0, -1.0, 0.0]])


def scan_of(*parts: tuple[int, int, np.ndarray]) -> LabelledScan:
    made = cloud([*parts, FAR])
    return LabelledScan(5, "lidar", made)


def test_objects_have_the_names_of_their_classes_and_dropped_ones_are_not_looked_for() -> None:
    scan = scan_of((80, 0, post(8.0, 2.0)), (71, 0, post(7.0, -3.0)), (10, 0, post(5.0, 4.0)))
    (found,) = InputRecords(Config(labels=LABELS), LabelMap(LABELS), SensorFrames()).prepare([scan])
    assert isinstance(found, ObjectDetections)
    assert (found.stamp_ns, found.frame_id) == (5, "lidar")
    places = dict(zip(found.labels, found.positions[:, :2].tolist(), strict=True))
    assert places == {"pole": pytest.approx([8.0, 2.0], abs=0.1), "trunk": pytest.approx([7.0, -3.0], abs=0.1)}


@pytest.mark.parametrize(("R", "count"), [(np.eye(3), 1), (OPTICAL, 3)])
def test_parts_above_each_other_are_one_object_of_a_sensor_that_stands_upright(R: np.ndarray, count: int) -> None:
    """What is above is told by the transform to the body."""
    frames = SensorFrames()
    frames.add(Transform(0, "base_link", "lidar", make_transform(R, np.zeros(3))))
    points = post(20.0, 0.0, height_m=1.5)
    rings = np.concatenate([points[np.isclose(points[:, 2], z)] for z in (-1.0, -0.3, 0.4)])
    objects = ScanObjects(LabelMap(LABELS), frames)
    scan = scan_of((80, 0, rings))
    assert len(objects.find(scan, "base_link").labels) == count
    assert objects.find(scan, "base_link") is objects.find(scan, "base_link")
