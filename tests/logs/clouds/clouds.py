"""Labelled clouds for tests: poles and boxes of which a sensor sees one side."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from logs.clouds.labelled_cloud import LabelledCloud
from logs.messages import FloatArray

_CODES = {"f4": "float", "f8": "double", "u4": "uint", "i4": "int", "u1": "uchar"}
LAMP, SIGN, TREE = 302_020_400, 302_020_600, 304_020_000


def post(x_m: float, y_m: float, *, radius_m: float = 0.15, height_m: float = 3.0) -> FloatArray:
    """Points (N, 3) m of the half of a round post that is seen from the origin."""
    facing = np.arctan2(-y_m, -x_m) + np.linspace(-0.5, 0.5, 15) * np.pi
    z = np.arange(0.0, height_m, 0.1) - 1.0
    ring = np.array([x_m, y_m]) + radius_m * np.stack([np.cos(facing), np.sin(facing)], axis=1)
    return np.column_stack([np.tile(ring, (len(z), 1)), np.repeat(z, len(ring))])


FAR = (0, 0, np.array([[60.0, 0.0, 0.0]] * 100))
"""What gives a scan the reach of a car's LiDAR."""


def cloud(parts: Sequence[tuple[int, int, FloatArray]]) -> LabelledCloud:
    """Of (class, instance, points)."""
    classes = np.concatenate([np.full(len(points), number) for number, _, points in parts])
    instances = np.concatenate([np.full(len(points), instance) for _, instance, points in parts])
    positions = np.concatenate([points for _, _, points in parts])
    return LabelledCloud(positions, classes.astype(np.int64), instances.astype(np.int64))


def street(class_name: str, instance_name: str) -> np.ndarray:
    """Six posts with the published fields; the scanner passes them."""
    numbers = [LAMP, SIGN, LAMP, TREE, SIGN, LAMP]
    parts = [(number, 10 + i, post(12.0 * i, 5.0)) for i, number in enumerate(numbers)]
    parts += [(0, 0, np.zeros((20, 3)))]
    made = cloud(parts)
    kinds = [("x", "<f4"), ("y", "<f4"), ("z", "<f4"), ("x_origin", "<f4"), ("y_origin", "<f4")]
    kinds += [("GPS_time", "<f8"), ("reflectance", "<u1")]
    points = np.zeros(len(made.positions), np.dtype([*kinds, (instance_name, "<u4"), (class_name, "<u4")]))
    for axis, name in enumerate("xyz"):
        points[name] = made.positions[:, axis]
    points["x_origin"] = made.positions[:, 0]
    points[class_name] = made.classes
    points[instance_name] = made.instances
    return points


def write_ply(path: Path, points: np.ndarray, order: str = "binary_little_endian") -> Path:
    """``points``: a structured array (N,)."""
    lines = ["ply", f"format {order} 1.0", "comment made by a test", f"element vertex {len(points)}"]
    lines += [f"property {_CODES[kind[1:]]} {name}" for name, kind in points.dtype.descr]
    header = "\n".join([*lines, "element face 0", "property list uchar int vertex_indices", "end_header\n"]).encode()
    path.write_bytes(header + points.astype(points.dtype.newbyteorder("<" if "little" in order else ">")).tobytes())
    return path
