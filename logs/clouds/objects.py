"""Labelled points -> objects: instances, or clusters of each class, each with its centre, extent and covariance."""

from collections.abc import Iterator, Mapping

import numpy as np
import pandas as pd
from scipy.sparse.csgraph import connected_components
from scipy.spatial import cKDTree

from logs.clouds.labelled_cloud import LabelledCloud
from logs.clouds.one_sided import seen_from_all_sides, seen_from_one_side
from logs.errors import DatasetError
from logs.messages import FloatArray, ObjectDetections
from logs.records import frozen


@frozen
class CloudObjects:
    """N objects in the frame of the cloud.

    positions (N, 3) m; covariances (N, 3, 3) m^2; labels (N,).
    """

    positions: FloatArray
    covariances: FloatArray
    labels: tuple[str, ...]

    def detections(self, stamp_ns: int, frame_id: str) -> ObjectDetections:
        """The record of these objects; each has the score 1."""
        scores = np.ones(len(self.labels))
        return ObjectDetections(stamp_ns, frame_id, self.positions, self.labels, scores, self.covariances)


def find_objects(
    cloud: LabelledCloud,
    names: Mapping[int, str] | None = None,
    *,
    viewpoint: FloatArray | None = None,
    upright: bool = True,
) -> CloudObjects:
    """Objects of a labelled cloud.

    Points of one class and instance are one object; those of instance 0, or of a cloud without instances, are clustered
    class by class. They are down-sampled to voxels, whose mean is the centroid (Xing et al., "Descriptellation", IV-B).

    Args:
        cloud: one scan, or a whole map.
        names: class number -> name of the classes that are objects; None: all but 0, named by their numbers.
        viewpoint: (3,) m, of the sensor in the frame of the cloud, of which it is one scan: objects are then seen from
            one side, and their centres lie behind what is seen. None: a map, seen from all sides.
        upright: z of the cloud points up.

    Returns:
        The objects, by class and instance or the order of their points; none of an empty cloud.

    Raises:
        DatasetError: points lie more than 2^20 voxels apart.
    """
    cloud = cloud.finite()
    scale = _scale(cloud, viewpoint)
    # All lengths are for the reach of a car's LiDAR, 60 m, and scaled with that of the scan.
    voxel_m = 0.1 * scale
    _check_extent(cloud, voxel_m)
    # 30 of 120,000 points of a scan.
    min_points = 5.0 if viewpoint is None else max(5.0, len(cloud.positions) / 4000.0)
    positions, covariances, labels = [], [], list[str]()
    # A wider gap between two parts of one class makes two objects of them.
    for label, points in _parts(cloud, names, 0.5 * scale, voxel_m, upright=upright):
        if len(points) < min_points:
            continue
        voxels = voxel_means(points, voxel_m)
        if viewpoint is None:
            centre = seen_from_all_sides(voxels, voxel_m)
        elif _length_m(voxels) > 15.0 * scale:
            continue  # a surface and no object
        else:
            spacing_m = _spacing_m(points, viewpoint)
            centre = seen_from_one_side(voxels, viewpoint, voxel_m, upright=upright, spacing_m=spacing_m)
        positions.append(centre.position)
        covariances.append(centre.covariance)
        labels.append(label)
    return CloudObjects(np.reshape(positions, (-1, 3)), np.reshape(covariances, (-1, 3, 3)), tuple(labels))


def _scale(cloud: LabelledCloud, viewpoint: FloatArray | None) -> float:
    """Power of two by which the reach of a scan differs from the nominal one; 1 for a map."""
    if viewpoint is None or len(cloud.positions) == 0:
        return 1.0
    reach_m = float(np.quantile(np.linalg.norm(cloud.positions - viewpoint, axis=1), 0.99))
    return float(2.0 ** np.round(np.log2(max(reach_m, 1e-3) / 60.0)))


def _check_extent(cloud: LabelledCloud, voxel_m: float) -> None:
    if len(cloud.positions) == 0:
        return
    low, high = cloud.positions.min(axis=0), cloud.positions.max(axis=0)
    # So that the places of all voxels can be numbered: 100 km of those of 0.1 m.
    most = 2**20
    astray = ~((high - low) / voxel_m < most) | ~(np.maximum(-low, high) / voxel_m < 2.0**62)
    if astray.any():
        axis = int(astray.argmax())
        raise DatasetError(
            f"a cloud reaches from {'xyz'[axis]} = {low[axis]:g} m to {high[axis]:g} m, more than {most} voxels "
            f"of {voxel_m:g} m; remove outliers"
        )


def _parts(
    cloud: LabelledCloud, names: Mapping[int, str] | None, gap_m: float, voxel_m: float, *, upright: bool
) -> Iterator[tuple[str, FloatArray]]:
    """Label and points (K, 3) m of each object."""
    table = pd.DataFrame({"class": cloud.classes, "instance": 0 if cloud.instances is None else cloud.instances})
    wanted = table["class"] != 0 if names is None else table["class"].isin(list(names))
    for (number, instance), rows in table[wanted].groupby(["class", "instance"]):
        points = cloud.positions[rows.index]
        for each in [points] if instance else _split(points, gap_m, voxel_m, flat=upright):
            yield str(number) if names is None else names[number], each


def _split(points: FloatArray, gap_m: float, voxel_m: float, *, flat: bool) -> list[FloatArray]:
    """The points of each cluster, as seen from above if ``flat``: beams lie wide apart in height."""
    corners = np.floor(points[:, : 2 if flat else 3] / voxel_m).astype(np.int64)
    cells, cell = np.unique(corners, axis=0, return_inverse=True)
    # DBSCAN (Ester et al., KDD 1996) in which every point is a core point: chains of steps of at most the gap.
    tree = cKDTree(voxel_m * cells.astype(np.float64))
    steps = tree.sparse_distance_matrix(tree, max(gap_m, 1.5 * voxel_m), output_type="coo_matrix")
    cluster = connected_components(steps, directed=False)[1][cell.ravel()]
    order = np.argsort(cluster, kind="stable")
    return np.split(points[order], np.flatnonzero(np.diff(cluster[order])) + 1)


def _spacing_m(points: FloatArray, viewpoint: FloatArray) -> float:
    """The widest gap between points (K, 3) m beside each other, as seen from the viewpoint (3,) m."""
    xy = (points - viewpoint)[:, :2]
    middle = complex(*xy.mean(axis=0))
    bearings = np.sort(np.angle((xy[:, 0] + 1j * xy[:, 1]) * np.conj(middle)))
    return abs(middle) * float(np.diff(bearings).max(initial=0.0))


def _length_m(voxels: FloatArray) -> float:
    """Along the longer of the horizontal main axes."""
    flat = voxels[:, :2] - voxels[:, :2].mean(axis=0)
    _, axes = np.linalg.eigh(flat.T @ flat)
    return float(np.ptp(flat @ axes, axis=0).max())


def voxel_means(points: FloatArray, voxel_m: float) -> FloatArray:
    """The mean of the points (N, 3) m in each voxel of side ``voxel_m``: (M, 3) m, M <= N."""
    corners = np.floor((points - points.min(axis=0)) / voxel_m).astype(np.int64)
    _, voxels, counts = np.unique(corners, axis=0, return_inverse=True, return_counts=True)
    sums = [np.bincount(voxels.ravel(), weights=axis) for axis in points.T]
    return np.stack(sums, axis=1) / counts[:, None]
