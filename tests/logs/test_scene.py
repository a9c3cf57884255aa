from __future__ import annotations

import pytest
from foxglove_schemas_protobuf.PointCloud_pb2 import PointCloud

from logs.errors import UnreadableLogError
from logs.scene import decode_lines, decode_points, decode_position


@pytest.mark.parametrize("decode", [decode_lines, decode_position, decode_points])
def test_bytes_of_another_message_are_refused(decode):
    with pytest.raises(UnreadableLogError, match="3 bytes do not decode as foxglove"):
        decode(b"\xff\xff\xff")


def test_points_that_end_within_a_point_are_refused():
    with pytest.raises(UnreadableLogError, match="17 bytes"):
        decode_points(PointCloud(data=bytes(17)).SerializeToString())
