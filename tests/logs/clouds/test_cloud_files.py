"""Labelled clouds in PLY files: their fields, the maps they become, and what is wrong with them."""

from pathlib import Path

import numpy as np
import pytest

from logs.clouds.cloud_files import read_cloud_map, read_points
from logs.clouds.labelled_cloud import LabelledCloud, labelled_cloud
from logs.errors import DatasetError
from tests.logs.clouds.clouds import LAMP, SIGN, street, write_ply


def read_cloud(path: Path) -> LabelledCloud:
    return labelled_cloud(read_points(path), path.name)


@pytest.mark.parametrize("order", ["binary_little_endian", "binary_big_endian"])
@pytest.mark.parametrize("names", [("class", "label"), ("class", "id"), ("scalar_Classification", "scalar_label")])
def test_published_fields_are_read_in_every_form(tmp_path: Path, order: str, names: tuple[str, str]) -> None:
    points = street(*names)
    found = read_cloud(write_ply(tmp_path / "cloud.ply", points, order))
    np.testing.assert_array_equal(found.classes, points[names[0]])
    np.testing.assert_array_equal(found.instances, points[names[1]])
    np.testing.assert_allclose(found.positions[:, 0], points["x"], rtol=1e-6)


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


@pytest.mark.parametrize(
    ("right", "wrong", "fault"),
    [
        (b"uint class", b"uint kind", "no field holds the class of a point .*; it has x, y, z"),
        (b"float x\n", b"float u\n", "no fields x, y and z; it has u, y"),
        (b"element vertex ", b"element vertex 9999999999", "not all of 9.* points are there; the file is truncated"),
        (b"element vertex ", b"element vertex 1", "not all of 1.* points are there; the file is truncated"),
        (b"float y\n", b"float x\n", "field .x. occurs more than once"),
        (b"ply\n", b"solid stl\n", "does not begin with a header"),
        (b"end_header", b"comment end", "not a readable binary PLY file"),
        (b"uchar reflectance", b"list uchar int reflectance", "not a readable binary PLY file .'list'"),
        (b"element vertex", b"element edge", "whose first element is the vertex"),
    ],
)
def test_damaged_ply_is_refused(tmp_path: Path, right: bytes, wrong: bytes, fault: str) -> None:
    path = write_ply(tmp_path / "cloud.ply", street("class", "id"))
    path.write_bytes(path.read_bytes().replace(right, wrong, 1))
    with pytest.raises(DatasetError, match=fault) as refused:
        read_cloud(path)
    assert "cloud.ply" in str(refused.value)
    assert "\n" not in str(refused.value)


@pytest.mark.parametrize("astray", [1e9, 1e30, -1e300])
def test_points_that_lie_astray_are_told(tmp_path: Path, astray: float) -> None:
    points = np.ones(9, dtype=[("x", "<f8"), ("y", "<f8"), ("z", "<f8"), ("class", "<u1")])
    points["y"][0] = astray
    fault = r"a\.ply: a cloud reaches from y = .* m, more than 1048576 voxels of 0\.1 m"
    with pytest.raises(DatasetError, match=fault):
        read_cloud_map(write_ply(tmp_path / "a.ply", points))


def test_map_of_cloud_has_named_classes(tmp_path: Path) -> None:
    path = write_ply(tmp_path / "cloud.ply", street("class", "id"))
    objects = read_cloud_map(path, {LAMP: "lamp", SIGN: "sign"})
    assert sorted(objects.labels) == ["lamp"] * 3 + ["sign"] * 2
    assert len(set(objects.ids)) == 5
    assert str(LAMP) in read_cloud_map(path).labels
    with pytest.raises(DatasetError, match=r"cloud.ply: 0 objects; a map needs .* The classes of its points: 0, "):
        read_cloud_map(path, {5: "lamp"})
