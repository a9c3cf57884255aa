"""The map as viewers draw it: objects and lines as foxglove.SceneUpdate, points as foxglove.PointCloud."""

import numpy as np
from foxglove_schemas_protobuf.Color_pb2 import Color
from foxglove_schemas_protobuf.LinePrimitive_pb2 import LinePrimitive
from foxglove_schemas_protobuf.PackedElementField_pb2 import PackedElementField
from foxglove_schemas_protobuf.PointCloud_pb2 import PointCloud
from foxglove_schemas_protobuf.SceneEntityDeletion_pb2 import SceneEntityDeletion
from foxglove_schemas_protobuf.SceneUpdate_pb2 import SceneUpdate
from google.protobuf.message import Message
from google.protobuf.timestamp_pb2 import Timestamp

from logs.messages import FloatArray, IntArray, SceneLines, SceneMarkers, ScenePoints

_POINT = np.dtype([*((axis, "<f4") for axis in "xyz"), *((color, "u1") for color in ("red", "green", "blue", "alpha"))])
_FIELD_TYPES = {np.dtype("<f4"): PackedElementField.FLOAT32, np.dtype("u1"): PackedElementField.UINT8}

CLASS_COLORS = (
    *("#2f8f2f", "#9467bd", "#8c564b", "#e377c2", "#9a9b1c", "#00a6fb"),
    *("#ff9896", "#c51b7d", "#7bc043", "#6a4fe0", "#f2c14e", "#8ecae6"),
)
"""Told apart from one another and from paths and closures, on white and on black."""


def class_colors(classes: IntArray) -> FloatArray:
    """Red, green, blue, alpha (N, 4) in [0, 1] of classes (N,), rows of the vocabulary of a map."""
    palette = np.array([[*bytes.fromhex(color[1:]), 255] for color in CLASS_COLORS]) / 255.0
    return palette[classes % len(palette)]


def encode_markers(markers: SceneMarkers) -> Message:
    """``markers`` as one update of the scene: an entity with shape and text for each object."""
    now, size_m, text_m = timestamp(markers.stamp_ns), 0.6, 0.5
    update = SceneUpdate()
    update.deletions.add(timestamp=now, type=SceneEntityDeletion.ALL)
    colors = [Color(**dict(zip("rgba", color, strict=True))) for color in class_colors(markers.classes).tolist()]
    rows = zip(markers.positions.tolist(), markers.classes.tolist(), markers.ids, colors, strict=True)
    for (x, y, z), number, object_id, color in rows:
        label = markers.vocabulary[number]
        entity = update.entities.add(timestamp=now, frame_id=markers.frame_id, id=object_id)
        entity.metadata.add(key="label", value=label)
        shape = entity.spheres.add(color=color)
        _place(shape.pose, x, y, z)
        shape.size.x = shape.size.y = shape.size.z = size_m
        text = entity.texts.add(billboard=True, font_size=text_m, color=color, text=label)
        _place(text.pose, x, y, z + size_m + 0.5 * text_m)
    return update


def encode_lines(lines: SceneLines) -> Message:
    """``lines`` as the only entity of the scene, a line strip for each polyline."""
    now = timestamp(lines.stamp_ns)
    update = SceneUpdate(deletions=[SceneEntityDeletion(timestamp=now, type=SceneEntityDeletion.ALL)])
    entity = update.entities.add(timestamp=now, frame_id=lines.frame_id, id="lines")
    color = Color(**dict(zip("rgba", lines.color, strict=True)))
    for polyline in lines.polylines:
        strip = entity.lines.add(type=LinePrimitive.LINE_STRIP, thickness=2.0, scale_invariant=True, color=color)
        strip.pose.orientation.w = 1.0
        for x, y, z in polyline.tolist():
            strip.points.add(x=x, y=y, z=z)
    return update


def encode_points(points: ScenePoints) -> Message:
    """``points`` as a cloud of float32 metres and one byte a colour."""
    columns = np.hstack([points.positions, np.rint(255.0 * points.colors)])
    rows = np.rec.fromarrays(columns.T, dtype=_POINT)
    cloud = PointCloud(
        timestamp=timestamp(points.stamp_ns),
        frame_id=points.frame_id,
        point_stride=_POINT.itemsize,
        data=rows.tobytes(),
    )
    cloud.pose.orientation.w = 1.0
    for name, (kind, offset, *_) in (_POINT.fields or {}).items():
        cloud.fields.add(name=name, offset=offset, type=_FIELD_TYPES[kind])
    return cloud


def timestamp(stamp_ns: int) -> Timestamp:
    """``stamp_ns`` as protobuf has times."""
    found = Timestamp()
    found.FromNanoseconds(int(stamp_ns))
    return found


def _place(pose: Message, x: float, y: float, z: float) -> None:
    pose.position.x, pose.position.y, pose.position.z = x, y, z  # type: ignore[attr-defined]
    pose.orientation.w = 1.0  # type: ignore[attr-defined]
