"""SemanticKITTI: Velodyne scans, a label for each point, poses and calibration of a KITTI odometry sequence."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from logs.clouds.class_names import SEMANTIC_KITTI_OBJECTS
from logs.clouds.labelled_cloud import LabelledCloud
from logs.clouds.objects import CloudSettings, find_objects
from logs.clouds.residuals import check_poses
from logs.errors import DatasetError
from logs.importers.imported_log import ImportedRecord, ImportSummary, write_imported_log
from logs.importers.kitti_poses import body_poses, parse_calibration, parse_poses, parse_times
from logs.importers.text_files import read_text_file, sha256_of
from logs.messages import FloatArray, GroundTruthPose, ObjectDetections, Odometry
from logs.storage.regular_file import read_regular

_SENSOR = np.zeros(3)


@dataclass(frozen=True, slots=True, eq=False)
class SemanticKitti:
    """The files of one sequence: scans by number, their stamps and poses; body, odom and world as in KITTI objects."""

    scans: tuple[tuple[int, Path, Path], ...]
    stamps_ns: tuple[int, ...]
    T_odom_body: FloatArray
    T_world_body: FloatArray | None
    source: dict[str, str]

    def detections(
        self, settings: CloudSettings | None = None, progress: Callable[[float], None] | None = None
    ) -> list[ObjectDetections]:
        """The objects of each scan."""
        found = []
        for done, (number, points, labels) in enumerate(self.scans, start=1):
            cloud = read_semantic_kitti_scan(points, labels)
            try:
                objects = find_objects(cloud, SEMANTIC_KITTI_OBJECTS, settings, viewpoint=_SENSOR)
            except DatasetError as error:
                raise DatasetError(f"{points}: {error}") from error
            found.append(objects.detections(self.stamps_ns[number], "base_link"))
            if progress is not None:
                progress(done / len(self.scans))
        return found

    def records(self, detections: list[ObjectDetections]) -> Iterator[ImportedRecord]:
        """For each scan in the order of time: odometry, detections, truth where known."""
        for (number, _, _), found in zip(self.scans, detections, strict=True):
            yield Odometry(found.stamp_ns, self.T_odom_body[number])
            yield found
            if self.T_world_body is not None:
                yield GroundTruthPose(found.stamp_ns, self.T_world_body[number])


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
    *, scans: Path, labels: Path, odometry: Path, calib: Path, times: Path, ground_truth: Path | None = None
) -> SemanticKitti:
    """Find the scans of a sequence and read what belongs to them.

    Args:
        scans: folder with ``NNNNNN.bin``; the number is the row of poses and times, so that some may be left out.
        labels: folder with ``NNNNNN.label``: labels or predictions.
        odometry: poses of the left camera, KITTI format.
        calib: KITTI's calibration; ``Tr`` maps velodyne to left camera.
        times: seconds of each scan.
        ground_truth: true poses of the left camera.

    Raises:
        DatasetError: a file that is missing or wrong, or numbers that do not fit together.
    """
    texts = {"odometry": read_text_file(odometry), "calib": read_text_file(calib), "times": read_text_file(times)}
    if ground_truth is not None:
        texts["ground_truth"] = read_text_file(ground_truth)
    stamps_ns = parse_times(texts["times"])
    T_camera_velodyne = parse_calibration(texts["calib"])
    bodies = {}
    for role in ("odometry", "ground_truth"):
        if role in texts:
            bodies[role] = body_poses(parse_poses(texts[role]), T_camera_velodyne)
            if len(bodies[role]) != len(stamps_ns):
                raise DatasetError(
                    f"{len(bodies[role])} poses in {texts[role].name}, {len(stamps_ns)} times in {times.name}: the "
                    "numbers must be equal; give files of one sequence"
                )
    source = {"dataset": "semantic-kitti"}
    for role, text in texts.items():
        source |= {role: Path(text.name).name, f"{role}_sha256": sha256_of([text])}
    found = tuple(_pairs(scans, labels, len(stamps_ns)))
    return SemanticKitti(found, tuple(stamps_ns), bodies["odometry"], bodies.get("ground_truth"), source)


def import_semantic_kitti(
    output: Path,
    *,
    scans: Path,
    labels: Path,
    odometry: Path,
    calib: Path,
    times: Path,
    ground_truth: Path | None = None,
    settings: CloudSettings | None = None,
    progress: Callable[[float], None] | None = None,
) -> ImportSummary:
    """Write a sequence (see :func:`read_semantic_kitti`) as a log with /odom, /detections and, with truth, its poses.

    Raises:
        DatasetError: the input is missing or wrong, its objects do not stand still under its poses, or Open3D is
            missing; nothing is written then.
        UnwritableLogError: the log cannot be written.
    """
    sequence = read_semantic_kitti(
        scans=scans, labels=labels, odometry=odometry, calib=calib, times=times, ground_truth=ground_truth
    )
    detections = sequence.detections(settings, progress)
    poses = sequence.T_odom_body[[number for number, _, _ in sequence.scans]]
    check_poses(detections, poses, f"{calib.name} and {odometry.name}")
    return write_imported_log(output, sequence.records(detections), sequence.source)


def _read(path: Path, dtype: str, width: int) -> np.ndarray:
    try:
        data = read_regular(path)
    except OSError as error:
        raise DatasetError(f"{path}: cannot be read ({error.strerror}); every scan needs its file") from error
    size = np.dtype(dtype).itemsize * width
    if len(data) % size:
        raise DatasetError(f"{path}: {len(data)} bytes are no whole number of points of {size} bytes; it is cut off")
    return np.frombuffer(data, dtype=dtype).reshape(-1, width)


def _pairs(scans: Path, labels: Path, count: int) -> Iterator[tuple[int, Path, Path]]:
    points = sorted((path for path in scans.glob("*.bin") if path.stem.isdecimal()), key=lambda path: int(path.stem))
    if not points:
        raise DatasetError(f"{scans}: no scan NNNNNN.bin in it; give the folder velodyne of a sequence")
    for path in points:
        if int(path.stem) >= count:
            raise DatasetError(f"{path}: there are only {count} poses; give poses and times of this sequence")
        label = labels / f"{path.stem}.label"
        if not label.is_file():
            raise DatasetError(f"{label}: missing; {path.name} needs its labels (--labels)")
        yield int(path.stem), path, label
