"""Which scans of a log are mapped."""

from logs.messages import ObjectDetections, Odometry
from slam.common.config import Config
from slam.frontend.input.input_records import InputRecords
from slam.frontend.input.label_map import LabelMap
from slam.frontend.input.sensor_frames import SensorFrames
from tests.helpers.landmarks import detections_of
from tests.helpers.poses import pose_at

ROW = [[5.0, 1.0, 0.0], [9.0, -2.0, 0.0]]


def scan(stamp_ns: int, positions: list[list[float]], frame: str = "lidar") -> ObjectDetections:
    return detections_of(positions, stamp_ns=stamp_ns, frame_id=frame)


def prepared(*scans: ObjectDetections, speed_m: float = 0.1) -> tuple[list[int], dict[str, int]]:
    """Stamps of the scans to map, and what was counted; the body moves by ``speed_m`` from one to the next."""
    config = Config()
    inputs = InputRecords(config, LabelMap(config.labels), SensorFrames())
    records: list[Odometry | ObjectDetections] = []
    for row, each in enumerate(scans):
        records += [Odometry(each.stamp_ns, pose_at(speed_m * row)), each]
    stamps = [each.stamp_ns for each in inputs.prepare(records) if isinstance(each, ObjectDetections)]
    return stamps, inputs.counters


def test_a_scan_that_is_repeated_to_the_last_digit_is_left_out_and_counted() -> None:
    other = [[5.0, 1.0, 0.0], [9.0, -2.0, 1e-12]]
    assert prepared(scan(1, ROW), scan(2, ROW), scan(3, ROW), scan(4, other)) == ([1, 4], {"detections_repeated": 2})


def test_a_body_that_stands_still_may_see_the_same() -> None:
    assert prepared(scan(1, ROW), scan(2, ROW), scan(3, ROW), speed_m=0.0) == ([1, 2, 3], {})


def test_scans_of_other_sensors_empty_scans_and_copies_of_messages_are_no_repetitions() -> None:
    assert prepared(scan(1, ROW), scan(2, ROW, "rear"), scan(3, [])) == ([1, 2, 3], {})
    assert prepared(scan(1, []), scan(2, [])) == ([1, 2], {})
    assert prepared(scan(1, ROW), scan(1, ROW)) == ([1, 1], {})
