import tarfile

import numpy as np

from logs.clouds.labelled_cloud import LabelledCloud
from logs.clouds.objects import CloudObjects, find_objects
from logs.messages import FloatArray
from tests.helpers.data import KITTI, SCANS, needs_scans
from tests.logs.clouds.clouds import FAR, cloud, post

ORIGIN = np.zeros(3)
NAMES = {80: "pole", 71: "trunk", 10: "car"}


def seen(*parts: tuple[int, int, FloatArray], upright: bool = True) -> CloudObjects:
    """Objects in a scan of a sensor at the origin."""
    return find_objects(cloud([*parts, FAR]), NAMES, upright=upright, viewpoint=ORIGIN)


def test_clusters_of_a_class_are_objects_where_there_are_no_instances() -> None:
    found = seen((80, 0, post(8.0, 2.0)), (80, 0, post(8.0, 4.0)), (71, 0, post(8.3, 2.0)))
    assert found.labels == ("trunk", "pole", "pole")


def test_points_of_one_instance_are_one_object_however_far_apart() -> None:
    found = seen((80, 3, post(8.0, 2.0)), (80, 3, post(8.0, 5.0)), (80, 4, post(8.0, 5.5)))
    assert found.labels == ("pole", "pole")


def test_rings_of_a_sensor_with_few_beams_are_one_object() -> None:
    points = post(20.0, 0.0)
    rings = points[np.isclose(points[:, 2] % 0.7, 0.0, atol=0.05) | np.isclose(points[:, 2] % 0.7, 0.7, atol=0.05)]
    assert len(seen((80, 0, rings)).labels) == 1
    assert len(seen((80, 0, rings), upright=False).labels) > 1


def test_too_small_and_too_long_objects_are_left_out() -> None:
    wall = np.concatenate([post(6.0, y) for y in np.arange(-10.0, 10.0, 0.25)])
    without_small = find_objects(cloud([(80, 0, post(9.0, 0.0)), (10, 0, post(5.0, 0.0)[:3])]), NAMES)
    without_long = seen((80, 0, post(9.0, 0.0)), (71, 0, wall))
    assert without_small.labels == without_long.labels == ("pole",)


def test_lengths_follow_the_reach_of_the_sensor() -> None:
    posts = [(80, 0, post(8.0, 0.0)), (80, 0, post(8.0, 1.0)), FAR]
    large = find_objects(cloud(posts), NAMES, viewpoint=ORIGIN)
    small = find_objects(cloud([(c, i, 0.125 * points) for c, i, points in posts]), NAMES, viewpoint=ORIGIN)
    np.testing.assert_allclose(small.positions, 0.125 * large.positions, atol=1e-12)
    np.testing.assert_allclose(small.covariances, 0.125**2 * large.covariances, atol=1e-12)


def test_a_map_is_seen_from_all_sides_and_gives_the_mean_of_the_voxels() -> None:
    points = np.array([[0.01, 0.0, 0.0]] * 90 + [[1.01, 0.0, 0.0]] * 10)
    found = find_objects(cloud([(80, 5, points)]), NAMES)
    np.testing.assert_allclose(found.positions, [[0.51, 0.0, 0.0]], atol=1e-9)


def test_beams_that_hit_nothing_and_empty_clouds_are_no_objects() -> None:
    nothing = LabelledCloud(np.full((50, 3), np.nan), np.full(50, 80), np.zeros(50, int))
    assert find_objects(nothing, NAMES, viewpoint=ORIGIN).positions.shape == (0, 3)
    empty = LabelledCloud(np.zeros((0, 3)), np.zeros(0, int))
    assert find_objects(empty, viewpoint=ORIGIN).detections(0, "lidar").labels == ()


def real_objects(name: str) -> CloudObjects:
    points = np.fromfile(SCANS / f"{name}.bin", np.float32).reshape(-1, 4)[:, :3].astype(np.float64)
    tags = np.fromfile(SCANS / f"{name}.label", np.uint32).astype(np.int64)
    return find_objects(LabelledCloud(points, tags & 0xFFFF, tags >> 16), NAMES, viewpoint=ORIGIN)


@needs_scans
def test_objects_of_real_scans_are_those_that_were_published() -> None:
    with tarfile.open(KITTI / "gosmatch_00.tar.xz") as archive:

        def lines(name: str) -> list[str]:
            member = archive.extractfile(f"00/{name}")
            return member.read().decode().split("\n")

        counts = lines("bow.txt")
        for name in ("000052", "004501"):
            vehicles, trunks, poles = (int(n) for n in counts[int(name)].split(","))
            centroids = np.array([[float(v) for v in line.split()] for line in lines(f"centroids/{name}.txt") if line])
            objects = real_objects(name)
            published = {"trunk": centroids[vehicles : vehicles + trunks], "pole": centroids[-poles:]}
            for label, theirs in published.items():
                ours = objects.positions[[found == label for found in objects.labels]]
                apart = np.linalg.norm(theirs[:, None] - ours[None], axis=2)
                assert np.mean(apart.min(axis=1) < 0.5) >= 0.9
                assert np.mean(apart.min(axis=0) < 0.5) >= 0.9
