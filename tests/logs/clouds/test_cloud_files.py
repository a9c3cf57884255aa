"""Labelled clouds in PLY and PCD files: their fields, the maps they become, and what is wrong with them."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from logs.clouds.class_names import BOLLARD
from logs.clouds.cloud_files import ANY, IQMULUS, PARIS_LILLE, CloudFields, read_cloud
from logs.clouds.map_of_cloud import named_objects, urban_objects
from logs.clouds.objects import find_objects
from logs.clouds.occlusion import visible_objects
from logs.errors import DatasetError
from logs.messages import FloatArray
from tests.logs.clouds.clouds import cloud, needs_open3d, post

_CODES = {"f4": "float", "f8": "double", "u4": "uint", "i4": "int", "u1": "uchar"}
LAMP, SIGN, TREE, PERSON, ROAD = 302_020_400, 302_020_600, 304_020_000, 303_020_000, 202_020_000


def write_ply(path: Path, points: np.ndarray, order: str = "binary_little_endian") -> Path:
    """``points``: a structured array (N,)."""
    lines = ["ply", f"format {order} 1.0", "comment made by a test", f"element vertex {len(points)}"]
    lines += [f"property {_CODES[kind[1:]]} {name}" for name, kind in points.dtype.descr]
    header = "\n".join([*lines, "element face 0", "property list uchar int vertex_indices", "end_header\n"]).encode()
    if order == "ascii":
        body = "".join(" ".join(map(str, row)) + "\n" for row in points.tolist()).encode()
    else:
        body = points.astype(points.dtype.newbyteorder("<" if "little" in order else ">")).tobytes()
    path.write_bytes(header + body)
    return path


def street(class_name: str, instance_name: str) -> np.ndarray:
    """Six posts of their own instance, a road, a person and a bollard, with the fields that are published."""
    numbers = [LAMP, SIGN, LAMP, TREE, SIGN, LAMP]
    parts = [(number, 10 + i, post(12.0 * i, 5.0)) for i, number in enumerate(numbers)]
    parts += [(PERSON, 30, post(3.0, 1.0)), (BOLLARD, 31, post(9.0, 2.0)), (ROAD, 1, np.ones((50, 3)))]
    parts += [(0, 0, np.zeros((20, 3)))]
    made = cloud(parts)
    kinds = [("x", "<f4"), ("y", "<f4"), ("z", "<f4"), ("x_origin", "<f4"), ("GPS_time", "<f8"), ("reflectance", "<u1")]
    points = np.zeros(len(made.positions), np.dtype([*kinds, (instance_name, "<u4"), (class_name, "<u4")]))
    for axis, name in enumerate("xyz"):
        points[name] = made.positions[:, axis]
    points[class_name] = made.classes
    points[instance_name] = made.instances
    return points


@pytest.mark.parametrize("order", ["binary_little_endian", "binary_big_endian", "ascii"])
def test_published_fields_are_read_in_every_form(tmp_path: Path, order: str) -> None:
    points = street("class", "label")
    found = read_cloud(write_ply(tmp_path / "Lille1.ply", points, order), PARIS_LILLE)
    np.testing.assert_array_equal(found.classes, points["class"])
    np.testing.assert_array_equal(found.instances, points["label"])
    np.testing.assert_allclose(found.positions[:, 0], points["x"], rtol=1e-6)


@pytest.mark.parametrize(
    ("names", "fields"),
    [(("class", "id"), IQMULUS), (("class", "id"), ANY), (("scalar_Classification", "scalar_label"), ANY)],
)
def test_class_and_instance_are_found_by_their_names(
    tmp_path: Path, names: tuple[str, str], fields: CloudFields
) -> None:
    points = street(*names)
    found = read_cloud(write_ply(tmp_path / "cloud.ply", points), fields)
    np.testing.assert_array_equal(found.classes, points[names[0]])
    np.testing.assert_array_equal(found.instances, points[names[1]])


def test_a_label_alone_is_the_class_and_the_instance_may_be_in_its_upper_half(tmp_path: Path) -> None:
    points = street("label", "unused")[["x", "y", "z", "label"]]
    points = np.array(points.tolist(), dtype=[("x", "<f4"), ("y", "<f4"), ("z", "<f4"), ("label", "<u4")])
    points["label"] = 80 + (7 << 16)
    found = read_cloud(write_ply(tmp_path / "cloud.ply", points))
    assert set(found.classes.tolist()) == {80}
    assert found.instances is not None
    assert set(found.instances.tolist()) == {7}
    points["label"] = 80
    assert read_cloud(write_ply(tmp_path / "cloud.ply", points)).instances is None


@needs_open3d
def test_the_preprocessing_of_the_paper(tmp_path: Path) -> None:
    found = read_cloud(write_ply(tmp_path / "Lille1.ply", street("class", "label")), PARIS_LILLE)
    objects, summary = urban_objects(found, "Lille1.ply", "")
    assert sorted(objects.labels) == ["floor lamp"] * 3 + ["traffic sign"] * 2 + ["tree"]
    assert (summary.original, summary.preprocessed) == ((9, 6), (6, 3))
    assert summary.left_out == {"bollard": 1, "dynamic": 1, "surface": 1, "unknown": 0}
    np.testing.assert_allclose(np.sort(objects.positions[:, 0]), 12.0 * np.arange(6), atol=0.3)
    assert len(set(objects.ids)) == 6


@needs_open3d
def test_classes_can_be_named_and_others_are_left_out(tmp_path: Path) -> None:
    found = read_cloud(write_ply(tmp_path / "cloud.ply", street("class", "id")))
    objects, summary = named_objects(found, "cloud.ply", "", {LAMP: "lamp", SIGN: "sign"})
    assert sorted(objects.labels) == ["lamp"] * 3 + ["sign"] * 2
    assert summary.left_out["unnamed"] == 4
    everything, _ = named_objects(found, "cloud.ply", "")
    assert str(LAMP) in everything.labels
    with pytest.raises(DatasetError, match=r"cloud.ply: 0 objects; a map needs at least four"):
        named_objects(found, "cloud.ply", "", {5: "lamp"})


PCD = """VERSION 0.7
FIELDS x y z label instance
SIZE 4 4 4 4 2
TYPE F F F U U
COUNT 1 1 1 1 1
WIDTH 2
HEIGHT 1
VIEWPOINT 0 0 0 1 0 0 0
POINTS 2
DATA ascii
1 2 3 80 5
6 7 8 71 0
"""


@needs_open3d
def test_pcd(tmp_path: Path) -> None:
    path = tmp_path / "cloud.pcd"
    path.write_text(PCD)
    found = read_cloud(path)
    np.testing.assert_array_equal(found.positions, [[1, 2, 3], [6, 7, 8]])
    assert (found.classes.tolist(), found.instances.tolist()) == ([80, 71], [5, 0])
    path.write_text("no cloud\n")
    with pytest.raises(DatasetError, match="no PCD file"):
        read_cloud(path)


def damaged(path: Path, kind: str) -> Path:
    points = street("class", "label")
    if kind == "no class":
        return write_ply(path, np.array(points[["x", "y", "z"]].tolist(), points.dtype.descr[:3]))
    if kind == "no positions":
        return write_ply(path, np.array(points[["class"]].tolist(), [("class", "<u4")]))
    write_ply(path, points)
    content = path.read_bytes()
    changes = {
        "cut off": content[:-100],
        "no ply": b"solid stl\n" + content,
        "no end": content.replace(b"end_header", b"comment end"),
        "a list": content.replace(b"property uchar reflectance", b"property list uchar int reflectance"),
        "faces first": content.replace(b"element vertex", b"element edge"),
        "a fraction": content.replace(b"property uint label", b"property float class2"),
    }
    path.write_bytes(changes[kind])
    return path


@pytest.mark.parametrize(
    ("kind", "fault"),
    [
        ("no class", "no field tells the class of a point .*; it has x, y, z"),
        ("no positions", "no fields x, y and z; it has class"),
        ("cut off", "of .* vertices are there; it is cut off"),
        ("no ply", "does not begin with 'ply'"),
        ("no end", "no PLY file that can be read"),
        ("a list", "which is no number"),
        ("faces first", "its first element is no vertex"),
    ],
)
def test_faults_are_one_line_with_the_file(tmp_path: Path, kind: str, fault: str) -> None:
    with pytest.raises(DatasetError, match=fault) as refused:
        read_cloud(damaged(tmp_path / "cloud.ply", kind))
    assert "cloud.ply" in str(refused.value)
    assert "\n" not in str(refused.value)
    with pytest.raises(DatasetError, match=r"none\.ply: cannot be read"):
        read_cloud(tmp_path / "none.ply")


def wall(x_m: float, width_m: float) -> FloatArray:
    y, z = np.meshgrid(np.arange(-width_m / 2, width_m / 2, 0.1), np.arange(-1.0, 3.0, 0.1))
    return np.column_stack([np.full(y.size, x_m), y.ravel(), z.ravel()])


@needs_open3d
def test_what_stands_behind_a_wall_is_not_seen() -> None:
    town = cloud([(1, 1, wall(10.0, 12.0)), (2, 2, post(15.0, 0.0)), (2, 3, post(8.0, 20.0)), (2, 4, post(80.0, 0.0))])
    objects = find_objects(town)
    seen = visible_objects(objects, np.zeros(3), range_m=40.0)
    assert [objects.instances[row] for row in seen] == [1, 3]
    around = visible_objects(objects, np.array([20.0, 0.0, 0.0]), range_m=40.0)
    assert 2 in [objects.instances[row] for row in around]
    assert len(visible_objects(objects, np.array([500.0, 0.0, 0.0]), range_m=40.0)) == 0
