"""Messages of a log as a stream of bytes."""

from collections import Counter
from io import BytesIO

import numpy as np
import pytest

from logs.errors import UnreadableLogError
from logs.messages import Odometry, StatusRecord, Transform
from logs.storage.stream import read_stream
from tests.helpers.landmarks import detections_of
from tests.helpers.short_drives import stream_of

SEEN = detections_of([1.0, 2.0, 3.0], stamp_ns=5)


def test_records_come_back_from_a_stream() -> None:
    counters = Counter[str]()
    records = [Odometry(5, np.eye(4)), SEEN, Transform(5, "base_link", "lidar", np.eye(4))]
    stream = stream_of((f"/topic{number}", 7 + number, record) for number, record in enumerate(records))
    items = list(read_stream(stream, counters))
    assert [(item.raw.topic, item.raw.log_time_ns) for item in items] == [(f"/topic{k}", 7 + k) for k in range(3)]
    assert [type(item.records[0]) for item in items] == [type(record) for record in records]
    np.testing.assert_array_equal(items[1].records[0].positions, SEEN.positions)
    assert not counters


def test_messages_that_are_no_input_are_counted() -> None:
    counters = Counter[str]()
    stream = stream_of([("/slam/status", 5, StatusRecord(5, "MAPPING", "info", "well"))])
    assert [item.records for item in read_stream(stream, counters)] == [()]
    assert counters == {"undecodable": 1}


@pytest.mark.parametrize("kept", [1, 12, -1])
def test_stream_that_breaks_off_in_a_message_is_refused(kept: int) -> None:
    content = stream_of([("/detections", 5, SEEN)]).getvalue()
    with pytest.raises(UnreadableLogError, match="not a dslam"):
        list(read_stream(BytesIO(content[:kept]), Counter()))
