"""Labelled clouds: by what names their fields are found, and points that lie astray."""

import numpy as np
import pytest

from logs.clouds.labelled_cloud import LabelledCloud, labelled_cloud
from logs.clouds.objects import find_objects
from logs.errors import DatasetError

PLACES = {axis: np.arange(3.0) for axis in "xyz"}


@pytest.mark.parametrize("names", [("class", "label"), ("class", "id"), ("scalar_Classification", "scalar_label")])
def test_published_fields_are_found(names: tuple[str, str]) -> None:
    classes, instances = np.array([5, 0, 5], np.uint32), np.array([7, 0, 8], np.uint32)
    found = labelled_cloud({**PLACES, names[1]: instances, names[0]: classes})
    np.testing.assert_array_equal(found.classes, classes)
    np.testing.assert_array_equal(found.instances, instances)
    np.testing.assert_array_equal(found.positions[:, 0], PLACES["x"])


def test_a_label_alone_is_the_class_and_the_instance_may_be_in_its_upper_half() -> None:
    found = labelled_cloud({**PLACES, "label": np.full(3, 80 + (7 << 16), np.uint32)})
    assert (found.classes.tolist(), np.unique(found.instances).tolist()) == ([80] * 3, [7])
    assert labelled_cloud({**PLACES, "label": np.full(3, 80)}).instances is None


@pytest.mark.parametrize(
    ("columns", "fault"),
    [
        ({**PLACES, "kind": np.ones(3)}, "no field holds the class of a point .*; it has x, y, z"),
        ({"u": np.ones(3), "y": np.ones(3), "class": np.ones(3)}, "no fields x, y and z; it has u, y"),
    ],
)
def test_clouds_without_places_or_classes_are_refused(columns: dict[str, np.ndarray], fault: str) -> None:
    with pytest.raises(DatasetError, match=f"cloud: {fault}"):
        labelled_cloud(columns)


@pytest.mark.parametrize("astray", [1e9, 1e30, -1e300])
def test_points_that_lie_astray_are_told(astray: float) -> None:
    positions = np.ones((9, 3))
    positions[0, 1] = astray
    fault = r"a cloud reaches from y = .* m, more than 1048576 voxels of 0\.1 m"
    with pytest.raises(DatasetError, match=fault):
        find_objects(LabelledCloud(positions, np.ones(9, np.int64)))
