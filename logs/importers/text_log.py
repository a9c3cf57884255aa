"""A drive in plain text files: poses of the odometry, a table of detections, fixes of satellites, true poses."""

import hashlib
from collections.abc import Iterable, Iterator, Sequence
from heapq import merge
from pathlib import Path

import numpy as np

from logs.errors import DatasetError
from logs.importers.imported_log import DriveRecord
from logs.importers.measurement_tables import BODY_FRAME, DetectionTable, read_detections, read_fixes
from logs.importers.tables import read_table
from logs.importers.text_files import read_source_text
from logs.importers.trajectory_files import Trajectory, read_trajectory
from logs.messages import GeodeticFix, GroundTruthPose, IntArray, ObjectDetections, Odometry
from logs.records import frozen

LABELS = ("vehicle", "trunk", "pole")
"""The classes in the order in which ``bow.txt`` of a folder of centroids counts them."""


@frozen
class TextLog:
    """A validated drive. ``source``: names of its files and their SHA-256; ``notes``: what a user should know of it."""

    odometry: Trajectory
    detections: DetectionTable
    ground_truth: Trajectory | None
    fixes: Sequence[GeodeticFix]
    source: dict[str, str]
    notes: tuple[str, ...]

    def records(self) -> Iterator[DriveRecord]:
        """Everything in the order of the stamps; at one stamp odometry, detections, fix, true pose, true objects."""
        truth = self.ground_truth.poses() if self.ground_truth is not None else ()
        streams: list[Iterable[DriveRecord]] = [
            (Odometry(stamp_ns, T) for stamp_ns, T in self.odometry.poses()),
            self.detections.records,
            self.fixes,
            (GroundTruthPose(stamp_ns, T) for stamp_ns, T in truth),
        ]
        return merge(*streams, key=lambda record: record.stamp_ns)


def read_text_log(
    *,
    odometry: Path,
    detections: Path,
    gnss: Path | None = None,
    ground_truth: Path | None = None,
    times: Path | None = None,
    calib: Path | None = None,
) -> TextLog:
    """Read and validate a drive.

    Args:
        odometry: poses of the body in a smooth frame; see ``TrajectoryFormat``.
        detections: CSV with a header, positions in the body frame; see :func:`read_detections`. Or a folder of
            centroids, one file for each pose; see :func:`read_centroids`.
        gnss: CSV with a header; see :func:`read_fixes`.
        ground_truth: true poses of the body.
        times: seconds of each pose of the trajectories in KITTI's format.
        calib: KITTI's calibration, if those poses are of the left camera.

    Raises:
        DatasetError: a file is missing or wrong; names the file, the line, the column and the remedy.
    """
    table = None if detections.is_dir() else detections
    paths = {"odometry": odometry, "detections": table, "gnss": gnss}
    paths |= {"ground_truth": ground_truth, "times": times, "calib": calib}
    sources = {role: read_source_text(path) for role, path in paths.items() if path is not None}
    times_ns = read_table(sources["times"], ["stamp_s"]).stamps(strictly=True) if "times" in sources else None
    trajectories = {
        role: read_trajectory(sources[role], times_ns=times_ns, calib=sources.get("calib"))
        for role in ("odometry", "ground_truth")
        if role in sources
    }
    path = trajectories["odometry"]
    about = {role: Path(source.name).name for role, source in sources.items()}
    about |= {f"{role}_sha256": source.sha256 for role, source in sources.items()}
    if "detections" in sources:
        found = read_detections(read_table(sources["detections"]))
    else:
        found, about["detections_sha256"] = read_centroids(detections, path.stamps_ns)
        about["detections"] = detections.resolve().name
    fixes = read_fixes(read_table(sources["gnss"])) if "gnss" in sources else []
    notes = found.notes
    if path.format == "kitti" and calib is None:
        notes += (
            "poses are taken for those of the body (x forward, z up); give --calib if they are of KITTI's left camera",
        )
    return TextLog(path, found, trajectories.get("ground_truth"), fixes, about, notes)


def read_centroids(folder: Path, stamps_ns: IntArray) -> tuple[DetectionTable, str]:
    """Objects clustered from the scans of a KITTI odometry sequence, in the files of GOSMatch: those of scans at
    ``stamps_ns`` (N,), in the frame of the velodyne, and a SHA-256 of all files.

    Args:
        folder: with ``bow.txt``, the number of objects of each class a line, and ``centroids/NNNNNN.txt``, metres.
        stamps_ns: of the scans.

    Raises:
        DatasetError: a file that is missing or wrong, or numbers of times, scans and centroids that differ.
    """
    bow = read_source_text(folder / "bow.txt")
    counts = read_table(bow, LABELS).matrix().tolist()
    if len(counts) != len(stamps_ns):
        raise DatasetError(f"{bow.name} counts {len(counts)} scans, of {len(stamps_ns)} poses; give files of one drive")
    digest = hashlib.sha256(bow.text.encode())
    found = []
    for scan, (stamp_ns, count) in enumerate(zip(stamps_ns.tolist(), counts, strict=True)):
        file = read_source_text(folder / "centroids" / f"{scan:06d}.txt")
        points = read_table(file, "xyz").matrix()
        if min(count) < 0 or len(points) != sum(count):
            raise DatasetError(f"{file.name} has {len(points)} centroids, but {bow.name} counts {count} for this scan")
        labels = tuple(np.repeat(LABELS, [int(number) for number in count]).tolist())
        found.append(ObjectDetections(stamp_ns, BODY_FRAME, points, labels, np.ones(len(points))))
        digest.update(file.text.encode())
    return DetectionTable(found), digest.hexdigest()
