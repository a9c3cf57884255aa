"""Objects clustered from the scans of a KITTI odometry sequence, in the files of GOSMatch."""

from __future__ import annotations

import hashlib
from pathlib import Path

import numpy as np

from logs.errors import DatasetError
from logs.importers.detection_tables import BODY_FRAME, DetectionTable
from logs.importers.tables import read_table
from logs.importers.text_files import read_source_text
from logs.messages import IntArray, ObjectDetections

LABELS = ("vehicle", "trunk", "pole")
"""The classes in the order in which ``bow.txt`` counts them."""


def read_centroids(folder: Path, stamps_ns: IntArray) -> tuple[DetectionTable, str]:
    """The objects of scans at ``stamps_ns`` (N,), in the frame of the velodyne, and a SHA-256 of all files.

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
