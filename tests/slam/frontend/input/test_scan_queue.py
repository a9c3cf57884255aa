"""Scans wait in the order of their stamps, and none is used twice."""

from logs.messages import ObjectDetections
from slam.frontend.input.scan_queue import ScanQueue
from tests.helpers.landmarks import detections_of


def detections(stamp_ns: int, frame_id: str = "sensor") -> ObjectDetections:
    return detections_of([], stamp_ns=stamp_ns, frame_id=frame_id)


def queue(*stamps_ns: int, time_offset_s: float = 0.0) -> ScanQueue:
    waiting = ScanQueue(time_offset_s)
    for stamp_ns in stamps_ns:
        waiting.add(detections(stamp_ns))
    return waiting


def test_a_stamp_from_the_future_holds_up_nothing():
    waiting = queue(900, 10, 20)
    assert [each.stamp_ns for each in waiting.take(until_ns=20)] == [10, 20]
    assert len(waiting) == 1


def test_scans_of_one_stamp_are_taken_as_they_came():
    waiting = ScanQueue()
    for frame in ("b", "a"):
        waiting.add(detections(10, frame))
    assert [each.frame_id for each in waiting.take(until_ns=10)] == ["b", "a"]


def test_an_offset_is_added_to_the_stamps():
    waiting = queue(10, time_offset_s=1e-9)
    assert list(waiting.take(until_ns=10)) == []
    assert len(list(waiting.take(until_ns=11))) == 1


def test_what_was_used_or_is_earlier_is_not_used_again():
    waiting = queue()
    waiting.note_used(detections(10))
    assert waiting.fault_of(detections(9)) == "detections_out_of_order"
    assert waiting.fault_of(detections(10)) == "detections_duplicated"
    assert waiting.fault_of(detections(10, "another")) is None
    waiting.note_used(detections(10, "another"))
    assert waiting.fault_of(detections(10)) == "detections_duplicated"
    waiting.note_used(detections(11))
    assert waiting.fault_of(detections(11, "another")) is None
