"""sensor_msgs/msg/PointCloud2 whose points have a class, and perhaps an instance."""

from __future__ import annotations

from typing import Any

import numpy as np

from logs.clouds.labelled_cloud import LabelledCloud, labelled_cloud
from logs.decoders.parts import Context, Records, place_of
from logs.decoders.ros2_images import image_rows
from logs.errors import DatasetError
from logs.messages import LabelledScan
from logs.validation import Refusal

_TYPES = {1: "i1", 2: "u1", 3: "i2", 4: "u2", 5: "i4", 6: "u4", 7: "f4", 8: "f8"}


def labelled_scan(message: Any, context: Context) -> Records:
    """The record of a PointCloud2; points without finite coordinates are left out."""
    place = place_of(message, context)
    point_step = int(message.point_step)
    if message.height * message.width == 0:
        return (LabelledScan(*place, LabelledCloud(np.zeros((0, 3)), np.zeros(0, np.int64))),)
    if point_step < 1:
        raise Refusal("lengths disagree", f"points of {point_step} bytes")
    order = ">" if message.is_bigendian else "<"
    numbers = [field for field in message.fields if field.count == 1 and field.datatype in _TYPES]
    fields = {field.name: (order + _TYPES[field.datatype], field.offset) for field in numbers}
    try:
        formats, offsets = zip(*fields.values(), strict=True) if fields else ((), ())
        kind = np.dtype({"names": [*fields], "formats": formats, "offsets": offsets, "itemsize": point_step})
    except (ValueError, TypeError) as error:
        raise Refusal("fields of the points are invalid", str(error)) from error
    points = image_rows(message, int(message.row_step), int(message.width) * point_step).view(kind).ravel()
    try:
        return (LabelledScan(*place, labelled_cloud({name: points[name] for name in fields}, "cloud").finite()),)
    except DatasetError as error:
        raise Refusal("cloud without labels", str(error)) from error
