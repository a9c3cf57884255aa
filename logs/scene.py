"""Pictures of a map for a viewer: foxglove.SceneUpdate, one shape and one colour per class."""

from __future__ import annotations

import colorsys
import zlib

from foxglove_schemas_protobuf.Color_pb2 import Color
from foxglove_schemas_protobuf.LinePrimitive_pb2 import LinePrimitive
from foxglove_schemas_protobuf.Point3_pb2 import Point3
from foxglove_schemas_protobuf.SceneEntity_pb2 import SceneEntity
from foxglove_schemas_protobuf.SceneEntityDeletion_pb2 import SceneEntityDeletion
from foxglove_schemas_protobuf.SceneUpdate_pb2 import SceneUpdate
from google.protobuf.message import Message
from google.protobuf.timestamp_pb2 import Timestamp

from logs.messages import SceneMarkers

_SHAPES = ("cubes", "spheres", "cylinders")
_SHAPE_SIZE_M = 0.6
_TEXT_HEIGHT_M = 0.5
_LINE_PIXELS = 2.0


def class_color(label: str) -> tuple[float, float, float, float]:
    """Red, green, blue, alpha in [0, 1] of a class: the same label has the same colour in every run and picture."""
    digest = zlib.crc32(label.encode())
    red, green, blue = colorsys.hsv_to_rgb((digest % 360) / 360.0, 0.55 + 0.4 * ((digest >> 9) % 8) / 7.0, 0.95)
    return red, green, blue, 1.0


def encode_markers(markers: SceneMarkers) -> Message:
    """``markers`` as one update of the picture: objects with shape and text, then the lines."""
    seconds, nanos = divmod(int(markers.stamp_ns), 1_000_000_000)
    now = Timestamp(seconds=seconds, nanos=nanos)
    everything = SceneEntityDeletion(timestamp=now, type=SceneEntityDeletion.ALL)
    update = SceneUpdate(deletions=[everything] if markers.replaces else [])
    colors = {label: Color(**dict(zip("rgba", class_color(label), strict=True))) for label in markers.labels}
    for (x, y, z), label, object_id in zip(markers.positions.tolist(), markers.labels, markers.ids, strict=True):
        entity = update.entities.add(timestamp=now, frame_id=markers.frame_id, id=object_id)
        entity.metadata.add(key="label", value=label)
        shape = getattr(entity, _SHAPES[zlib.crc32(label.encode()) % len(_SHAPES)]).add(color=colors[label])
        _place(shape.pose, x, y, z)
        shape.size.x = shape.size.y = shape.size.z = _SHAPE_SIZE_M
        if shape.DESCRIPTOR.name == "CylinderPrimitive":
            shape.bottom_scale = shape.top_scale = 1.0
        text = entity.texts.add(billboard=True, font_size=_TEXT_HEIGHT_M, color=colors[label], text=label)
        _place(text.pose, x, y, z + _SHAPE_SIZE_M + 0.5 * _TEXT_HEIGHT_M)
    if len(markers.lines):
        update.entities.append(_lines(markers, now))
    return update


def _lines(markers: SceneMarkers, now: Timestamp) -> SceneEntity:
    entity = SceneEntity(timestamp=now, frame_id=markers.frame_id, id="lines")
    primitive = entity.lines.add(type=LinePrimitive.LINE_LIST, thickness=_LINE_PIXELS, scale_invariant=True)
    _place(primitive.pose, 0.0, 0.0, 0.0)
    for ends, (r, g, b, a) in zip(markers.lines.tolist(), markers.line_colors.tolist(), strict=True):
        primitive.points.extend(Point3(x=x, y=y, z=z) for x, y, z in ends)
        primitive.colors.extend(Color(r=r, g=g, b=b, a=a) for _ in ends)
    return entity


def _place(pose: Message, x: float, y: float, z: float) -> None:
    pose.position.x, pose.position.y, pose.position.z = x, y, z  # type: ignore[attr-defined]
    pose.orientation.w = 1.0  # type: ignore[attr-defined]
