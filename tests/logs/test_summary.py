import numpy as np
import pytest

from logs import messages as m
from logs.summary import summarize
from tests.helpers.landmarks import detections_of
from tests.helpers.poses import pose_at
from tests.helpers.short_drives import write_log, write_records

SECOND = 1_000_000_000


def odometry(stamp_ns, x):
    return m.Odometry(stamp_ns, pose_at(x))


def detections(stamp_ns, *labels):
    return detections_of(np.zeros((len(labels), 3)), labels, stamp_ns=stamp_ns)


@pytest.fixture
def log(tmp_path):
    stamps_s = [0, 1, 2, 3, 3, 2, 4, 30, 31]
    entries = [
        ("/odom", SECOND * number, odometry(SECOND * (second + 1), float(second)))
        for number, second in enumerate(stamps_s, start=1)
    ]
    entries.append(("/detections", None, detections(SECOND, "tree", "pole", "tree")))
    entries.append(("/detections", None, detections(2 * SECOND)))
    for query, reference, stage, reason in [
        (4, 0, "acceptance", "waits for others"),
        (2, 0, "accepted", ""),
        (3, 1, "registration", "3 inliers of 1.5e-3"),
        (3, 2, "registration", "-12 inliers of 7"),
        (1, 0, "registration", "4 inliers of 20.5"),
        (2, 1, "registration", "no rotation"),
        (4, 0, "association", "thrown out"),
    ]:
        record = m.LoopClosureRecord(query * SECOND, query, reference, stage == "accepted", stage, reason)
        entries.append(("/slam/closures", None, record))
    return write_log(tmp_path / "log.mcap", entries, version={"dslam": "0"})


def test_a_summary_tells_what_is_there_and_what_is_odd(log):
    summary = summarize(log)
    by_topic = {topic.topic: topic for topic in summary.topics}
    odom = by_topic["/odom"]
    assert (odom.message_count, odom.duplicate_stamps, odom.out_of_order_stamps) == (9, 2, 1)
    assert (odom.gap_count, odom.longest_gap_s) == (1, 26.0)
    assert odom.rate_hz == pytest.approx(8 / 31)
    assert odom.frames == ("base_link", "odom")
    assert by_topic["/detections"].frames == ("lidar",)
    assert list(summary.class_counts.items()) == [("tree", 2), ("pole", 1)]
    assert odom.length_m == pytest.approx(3 + 0 + 1 + 2 + 26 + 1)
    assert by_topic["/detections"].length_m is None
    assert summary.duration_s == 8.0
    assert summary.selection.topics_of("detections") == ("/detections",)
    assert summary.obstacle == ""
    pairs = [(c.query_keyframe_id, c.reference_keyframe_id) for c in summary.closure_candidates]
    assert pairs == [(1, 0), (2, 0), (2, 1), (3, 1), (3, 2), (4, 0)]
    assert summary.closure_candidates[-1].reason == "thrown out"
    assert summary.first_stamp_ns == SECOND
    assert summary.metadata == {"version": {"dslam": "0"}}
    assert summary.counters == {}


def test_a_summary_of_a_log_without_messages(tmp_path):
    summary = summarize(write_records(tmp_path / "log.mcap", ()))
    assert (summary.topics, summary.duration_s) == ((), 0.0)
    assert "The log has no topics" in summary.obstacle


def test_overrides_are_what_would_be_used(log):
    assert "does not decode to odometry" in summarize(log, {"odometry": "/detections"}).obstacle
