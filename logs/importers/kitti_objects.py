"""KITTI odometry sequences with published object detections: camera poses, centroids, calibration and times."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from logs.importers.imported_log import ImportedRecord
from logs.importers.kitti import KittiDrive, read_drive
from logs.importers.object_scans import ObjectScans, read_object_scans
from logs.messages import ObjectDetections


@dataclass(frozen=True, slots=True, eq=False)
class KittiObjects:
    """One validated sequence: its drive, and the scans of each of its poses."""

    drive: KittiDrive
    scans: ObjectScans

    @property
    def source(self) -> dict[str, str]:
        """The names of the files and their SHA-256."""
        return {**self.drive.source, "detections": self.scans.sequence, "detections_sha256": self.scans.sha256}

    def records(self) -> Iterator[ImportedRecord]:
        """For each scan in the order of time: odometry, detections (scores 1, no covariances), truth where known."""
        return self.drive.records(enumerate(self._detections()))

    def _detections(self) -> Iterator[ObjectDetections]:
        scans = zip(self.drive.stamps_ns.tolist(), self.scans.positions, self.scans.labels, strict=True)
        for stamp_ns, positions, labels in scans:
            yield ObjectDetections(stamp_ns, "base_link", positions, labels, np.ones(len(labels)))


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
        detections: archive or folder with ``bow.txt`` and ``centroids/NNNNNN.txt``, metres, velodyne frame.
        odometry: estimated poses of the left camera, KITTI format.
        calib: KITTI odometry calibration; ``Tr`` maps velodyne to left camera.
        times: seconds of each scan.
        ground_truth: true poses of the left camera, same format as ``odometry``.

    Raises:
        DatasetError: a file that is missing or wrong, or numbers of poses, times and scans that differ.
    """
    scans = read_object_scans(detections)
    counts = {f"scans in {detections.name}": len(scans.positions)}
    return KittiObjects(read_drive("kitti-objects", odometry, calib, times, ground_truth, counts), scans)
