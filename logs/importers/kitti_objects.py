"""KITTI odometry sequences with published object detections: camera poses, centroids, calibration and times."""

from __future__ import annotations

import hashlib
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from logs.errors import DatasetError
from logs.importers.imported_log import DriveRecord
from logs.importers.kitti import body_poses, parse_calibration, parse_poses, read_times
from logs.importers.tables import read_table
from logs.importers.text_files import describe_sources, read_source_text
from logs.messages import FloatArray, GroundTruthPose, IntArray, ObjectDetections, Odometry

LABELS = ("vehicle", "trunk", "pole")
"""The classes in the order in which ``bow.txt`` counts them."""


@dataclass(frozen=True, slots=True, eq=False)
class KittiObjects:
    """stamps_ns (N,), ``T_odom_body`` (N, 4, 4), N detections (scores 1, no covariances) and, where known,
    ``T_world_body`` (N, 4, 4), metres.

    The body is the velodyne (x forward, y left, z up); odom and world are the velodyne frame of the first pose.
    ``source`` names each file and its SHA-256, without folders; of the detections, that of ``bow.txt`` and then the
    centroids in the order of scans.
    """

    stamps_ns: IntArray
    T_odom_body: FloatArray
    detections: tuple[ObjectDetections, ...]
    T_world_body: FloatArray | None
    source: dict[str, str]

    def records(self) -> Iterator[DriveRecord]:
        """For each scan in the order of time: odometry, detections, truth where known."""
        for row, found in enumerate(self.detections):
            yield Odometry(found.stamp_ns, self.T_odom_body[row])
            yield found
            if self.T_world_body is not None:
                yield GroundTruthPose(found.stamp_ns, self.T_world_body[row])


def read_kitti_objects(
    *,
    detections: Path,
    odometry: Path,
    calib: Path,
    times: Path,
    ground_truth: Path | None = None,
) -> KittiObjects:
    """Read and validate one sequence.

    Args:
        detections: folder with ``bow.txt`` and ``centroids/NNNNNN.txt``, metres, velodyne frame, as GOSMatch has them.
        odometry: estimated poses of the left camera, KITTI format.
        calib: KITTI odometry calibration; ``Tr`` maps velodyne to left camera.
        times: seconds of each scan.
        ground_truth: true poses of the left camera, same format as ``odometry``.

    Raises:
        DatasetError: a file that is missing or wrong, or numbers of poses, times and scans that differ.
    """
    paths = {"odometry": odometry, "calib": calib, "times": times, "ground_truth": ground_truth}
    texts = {role: read_source_text(path) for role, path in paths.items() if path is not None}
    bow = read_source_text(detections / "bow.txt")
    counts = read_table(bow, LABELS).matrix().tolist()
    stamps_ns = read_times(texts["times"]).stamps_ns
    T_camera_velodyne = parse_calibration(texts["calib"])
    poses = {
        role: body_poses(parse_poses(texts[role]), T_camera_velodyne)
        for role in ("odometry", "ground_truth")
        if role in texts
    }
    numbers = {"scans in bow.txt": len(counts), f"times in {times.name}": len(stamps_ns)}
    numbers |= {f"poses in {Path(texts[role].name).name}": len(T) for role, T in poses.items()}
    if len(set(numbers.values())) != 1:
        told = ", ".join(f"{number} {what}" for what, number in numbers.items())
        raise DatasetError(f"{told}: the numbers must be equal; give files of one sequence")
    digest = hashlib.sha256(bow.text.encode())
    found = []
    for scan, (stamp_ns, count) in enumerate(zip(stamps_ns.tolist(), counts, strict=True)):
        file = read_source_text(detections / "centroids" / f"{scan:06d}.txt")
        points = read_table(file, "xyz").matrix()
        if min(count) < 0 or len(points) != sum(count):
            raise DatasetError(f"{file.name} has {len(points)} centroids, but {bow.name} counts {count} for this scan")
        labels = tuple(np.repeat(LABELS, [int(number) for number in count]).tolist())
        found.append(ObjectDetections(stamp_ns, "base_link", points, labels, np.ones(len(points))))
        digest.update(file.text.encode())
    name = detections.resolve().name
    source = describe_sources("kitti-objects", texts.items())
    source |= {"detections": name, "detections_sha256": digest.hexdigest()}
    return KittiObjects(stamps_ns, poses["odometry"], tuple(found), poses.get("ground_truth"), source)
