"""KITTI odometry sequences with published object detections: camera poses, centroids, calibration and times."""

from __future__ import annotations

import hashlib
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from logs.errors import DatasetError
from logs.importers.imported_log import ImportedRecord
from logs.importers.kitti import KittiDrive, read_drive
from logs.importers.tables import read_table
from logs.importers.text_files import read_source_text
from logs.messages import ObjectDetections

LABELS = ("vehicle", "trunk", "pole")
"""The classes in the order in which ``bow.txt`` counts them."""


@dataclass(frozen=True, slots=True, eq=False)
class KittiObjects:
    """One validated sequence: its drive, and the detections of each of its poses (scores 1, no covariances).

    ``source``: the names of the files and their SHA-256; of the detections, that of ``bow.txt`` and then the centroids
    in the order of scans.
    """

    drive: KittiDrive
    detections: tuple[ObjectDetections, ...]
    source: dict[str, str]

    def records(self) -> Iterator[ImportedRecord]:
        """For each scan in the order of time: odometry, detections, truth where known."""
        return self.drive.records(enumerate(self.detections))


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
    bow = read_source_text(detections / "bow.txt")
    counts = [[int(number) for number in row] for row in read_table(bow, LABELS).matrix().tolist()]
    scans = {f"scans in {bow.name}": len(counts)}
    drive = read_drive("kitti-objects", odometry, calib, times, ground_truth, scans)
    digest = hashlib.sha256(bow.text.encode())
    found = []
    for scan, (stamp_ns, count) in enumerate(zip(drive.stamps_ns.tolist(), counts, strict=True)):
        file = read_source_text(detections / "centroids" / f"{scan:06d}.txt")
        points = read_table(file, "xyz").matrix()
        if min(count) < 0 or len(points) != sum(count):
            raise DatasetError(f"{file.name} has {len(points)} centroids, but {bow.name} counts {count} for this scan")
        labels = tuple(np.repeat(LABELS, count).tolist())
        found.append(ObjectDetections(stamp_ns, "base_link", points, labels, np.ones(len(points))))
        digest.update(file.text.encode())
    name = detections.resolve().name
    source = {**drive.source, "detections": name, "detections_sha256": digest.hexdigest()}
    return KittiObjects(drive, tuple(found), source)
