"""sensor_msgs/msg/PointCloud2 whose points have a class, and perhaps an instance."""

from __future__ import annotations

from collections import Counter
from typing import Any

import numpy as np

from logs.clouds.cloud_files import ANY, labelled_cloud
from logs.decoders.ros2_detections import place_of
from logs.errors import DatasetError
from logs.messages import LabelledScan, Record
from logs.topics import RawMessage
from logs.validation import Refusal

_TYPES = {1: "i1", 2: "u1", 3: "i2", 4: "u2", 5: "i4", 6: "u4", 7: "f4", 8: "f8"}


def labelled_scan(message: Any, raw: RawMessage, counters: Counter[str]) -> tuple[Record, ...]:
    """The record of a PointCloud2; points without finite coordinates are left out."""
    stamp, frame = place_of(message.header, raw.log_time_ns)
    height, width = int(message.height), int(message.width)
    if height * width == 0:
        return (LabelledScan(stamp, frame, np.zeros((0, 3)), np.zeros(0, np.int64)),)
    point_step, row_step = int(message.point_step), int(message.row_step)
    if row_step < width * point_step or len(message.data) < height * row_step or point_step < 1:
        raise Refusal("lengths disagree", f"{len(message.data)} bytes for {height} x {width} points")
    order = ">" if message.is_bigendian else "<"
    scalars = [field for field in message.fields if field.count == 1 and field.datatype in _TYPES]
    names, formats = [f.name for f in scalars], [order + _TYPES[f.datatype] for f in scalars]
    try:
        kind = np.dtype(
            {"names": names, "formats": formats, "offsets": [f.offset for f in scalars], "itemsize": point_step}
        )
    except (ValueError, TypeError) as error:
        raise Refusal("fields of the points are none", str(error)) from error
    rows = np.frombuffer(bytes(message.data), np.uint8)[: height * row_step].reshape(height, row_step)
    points = np.ascontiguousarray(rows[:, : width * point_step]).view(kind).ravel()
    try:
        cloud = labelled_cloud({name: points[name] for name in names}, ANY, "cloud").finite()
    except DatasetError as error:
        raise Refusal("cloud without labels", str(error)) from error
    return (LabelledScan(stamp, frame, cloud.positions, cloud.classes, cloud.instances),)
