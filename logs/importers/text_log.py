"""A drive in plain text files: poses of the odometry, a table of detections and, for evaluation, the true poses."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from heapq import merge
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from logs.importers.detection_tables import BODY_FRAME, DetectionTable, read_detections
from logs.importers.imported_log import DriveRecord
from logs.importers.stamps import match_clock
from logs.importers.tables import UNLABELLED, read_table
from logs.importers.text_files import describe_sources, read_source_text
from logs.importers.trajectory_files import Trajectory, TrajectoryFormat, read_trajectory
from logs.messages import GroundTruthPose, Odometry


@dataclass(frozen=True, slots=True, eq=False)
class TextLog:
    """A validated drive. ``notes``: what a user should know of it."""

    odometry: Trajectory
    detections: DetectionTable
    ground_truth: Trajectory | None
    source: dict[str, str]
    notes: tuple[str, ...]

    def records(self) -> Iterator[DriveRecord]:
        """Everything in the order of the stamps; at one stamp odometry, detections, the true pose, the true objects."""
        truth = self.ground_truth.poses() if self.ground_truth is not None else ()
        streams: list[Iterable[DriveRecord]] = [
            (Odometry(stamp_ns, T) for stamp_ns, T in self.odometry.poses()),
            (record for pair in self.detections.scans() for record in pair if record is not None),
            (GroundTruthPose(stamp_ns, T) for stamp_ns, T in truth),
        ]
        return merge(*streams, key=lambda record: record.stamp_ns)


def read_text_log(
    *,
    odometry: Path,
    detections: Path,
    ground_truth: Path | None = None,
    times: Path | None = None,
    calib: Path | None = None,
) -> TextLog:
    """Read and validate a drive.

    Args:
        odometry: poses of the body in a smooth frame; see :class:`TrajectoryFormat`.
        detections: CSV with a header, positions in the body frame; see :func:`read_detections`.
        ground_truth: true poses of the body.
        times: seconds of each pose of the trajectories in KITTI's format.
        calib: KITTI's calibration, if those poses are of the left camera.

    Raises:
        DatasetError: a file is missing or wrong; names the file, the line, the column and the remedy.
    """
    paths = {
        "odometry": odometry,
        "detections": detections,
        "ground_truth": ground_truth,
        "times": times,
        "calib": calib,
    }
    sources = {role: read_source_text(path) for role, path in paths.items() if path is not None}
    trajectories = {
        role: read_trajectory(sources[role], times=sources.get("times"), calib=sources.get("calib"))
        for role in ("odometry", "ground_truth")
        if role in sources
    }
    path, truth = trajectories["odometry"], trajectories.get("ground_truth")
    table = read_detections(read_table(sources["detections"]))
    inside = match_clock(table.stamps, path.stamps)
    if truth is not None:
        match_clock(truth.stamps, path.stamps)
    notes = _notes(table, inside)
    if path.format == TrajectoryFormat.KITTI and calib is None:
        notes.append(
            "poses are taken for those of the body (x forward, z up); give --calib if they are of KITTI's left camera"
        )
    return TextLog(path, table, truth, describe_sources("text", sources.items()), tuple(notes))


def _notes(table: DetectionTable, inside: NDArray[np.bool_]) -> list[str]:
    notes = []
    if not inside.all():
        text = table.stamps.table
        notes.append(
            f"{text.name}, line {text.lines[int(inside.argmin())]}, column {table.stamps.column.name}: "
            f"{np.count_nonzero(~inside)} of {len(inside)} detections, this one first, are outside the odometry's "
            "time; a replay leaves them out"
        )
    if table.unlabelled_count:
        counts = f"{table.unlabelled_count} of {len(inside)} detections"
        notes.append(f"{counts} have no label and are of the class {UNLABELLED}")
    frames = sorted(set(table.frames) - {BODY_FRAME})
    if frames:
        notes.append(
            f"detections are in {', '.join(frames)}, whose place on the body is not in these files: replay with "
            "--set calibration.detection.assume_body_frame=true if it is the body"
        )
    return notes
