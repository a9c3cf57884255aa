"""SemanticKITTI: Velodyne scans, a label for each point, poses and calibration of a KITTI odometry sequence."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from logs.clouds.class_names import SEMANTIC_KITTI_OBJECTS
from logs.clouds.labelled_cloud import LabelledCloud
from logs.clouds.objects import find_objects
from logs.errors import DatasetError
from logs.importers.imported_log import ImportedRecord
from logs.importers.kitti import KittiDrive, read_drive
from logs.messages import ObjectDetections
from logs.storage.regular_file import read_regular

_SENSOR = np.zeros(3)


@dataclass(frozen=True, slots=True, eq=False)
class SemanticKitti:
    """The files of one sequence: the row of the drive of each scan, its points and its labels."""

    drive: KittiDrive
    scans: tuple[tuple[int, Path, Path], ...]

    def detections(self, progress: Callable[[float], None] | None = None) -> list[ObjectDetections]:
        """The objects of each scan.

        Raises:
            DatasetError: a scan that is damaged.
        """
        found = []
        for done, (row, points, labels) in enumerate(self.scans, start=1):
            cloud = read_semantic_kitti_scan(points, labels)
            try:
                objects = find_objects(cloud, SEMANTIC_KITTI_OBJECTS, viewpoint=_SENSOR)
            except DatasetError as error:
                raise DatasetError(f"{points}: {error}") from error
            found.append(objects.detections(int(self.drive.stamps_ns[row]), "base_link"))
            if progress is not None:
                progress(done / len(self.scans))
        return found

    def records(self, progress: Callable[[float], None] | None = None) -> Iterator[ImportedRecord]:
        """For each scan in the order of time: odometry, detections, truth where known.

        Raises:
            DatasetError: as :meth:`detections`.
        """
        found = self.detections(progress)
        return self.drive.records(zip((row for row, _, _ in self.scans), found, strict=True))


def read_semantic_kitti_scan(points: Path, labels: Path) -> LabelledCloud:
    """One scan: float32 x y z intensity, and uint32 labels whose upper half is the instance, metres, velodyne frame.

    Raises:
        DatasetError: a file that is missing or has another number of points than the other.
    """
    xyz, numbers = _read(points, "<f4", 4), _read(labels, "<u4", 1)
    if len(xyz) != len(numbers):
        raise DatasetError(
            f"{labels}: {len(numbers)} labels, but {points.name} has {len(xyz)} points; give the labels of this scan"
        )
    tags = numbers[:, 0].astype(np.int64)
    return LabelledCloud(xyz[:, :3].astype(np.float64), tags & 0xFFFF, tags >> 16)


def read_semantic_kitti(
    sequence: Path, *, odometry: Path | None = None, ground_truth: Path | None = None
) -> SemanticKitti:
    """Find the scans of a sequence and read what belongs to them.

    Args:
        sequence: folder with velodyne/NNNNNN.bin, whose number is the row of poses and times, so that some may be left
            out; labels/NNNNNN.label, poses.txt, times.txt and calib.txt, whose ``Tr`` maps velodyne to left camera.
        odometry: poses of the left camera, KITTI format, instead of poses.txt.
        ground_truth: true poses of the left camera.

    Raises:
        DatasetError: a file that is missing or wrong, or numbers that do not fit together.
    """
    calib, times = sequence / "calib.txt", sequence / "times.txt"
    drive = read_drive("semantic-kitti", odometry or sequence / "poses.txt", calib, times, ground_truth, {})
    return SemanticKitti(drive, tuple(_pairs(sequence, len(drive.stamps_ns))))


def _read(path: Path, dtype: str, width: int) -> np.ndarray:
    try:
        data = read_regular(path)
    except OSError as error:
        raise DatasetError(f"{path}: cannot be read ({error.strerror}); every scan needs a file") from error
    size = np.dtype(dtype).itemsize * width
    if len(data) % size:
        raise DatasetError(
            f"{path}: {len(data)} bytes are not a multiple of {size}, the size of a point; it is truncated"
        )
    return np.frombuffer(data, dtype=dtype).reshape(-1, width)


def _pairs(sequence: Path, count: int) -> Iterator[tuple[int, Path, Path]]:
    points = sorted(path for path in sequence.glob("velodyne/*.bin") if path.stem.isdecimal())
    if not points:
        raise DatasetError(f"{sequence} holds no scan velodyne/NNNNNN.bin; give the folder of a sequence")
    for path in points:
        if int(path.stem) >= count:
            raise DatasetError(f"{path}: there are only {count} poses; give poses and times of this sequence")
        yield int(path.stem), path, sequence / "labels" / f"{path.stem}.label"
