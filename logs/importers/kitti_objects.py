"""KITTI odometry sequences with published object detections: camera poses, centroids, calibration and times."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from logs.errors import DatasetError
from logs.importers.imported_log import ImportSummary, write_imported_log
from logs.importers.kitti_poses import body_poses, parse_calibration, parse_poses, parse_times
from logs.importers.object_scans import ObjectScans, read_object_scans
from logs.importers.text_files import TextFile, read_text_file, sha256_of
from logs.messages import FloatArray, GroundTruthPose, ObjectDetections, Odometry


@dataclass(frozen=True, slots=True, eq=False)
class KittiObjects:
    """One validated sequence: stamps_ns, scans, ``T_odom_body`` (N, 4, 4) and, where known, ``T_world_body`` (N, 4, 4).

    The body is the velodyne (x forward, y left, z up); odom and world are the velodyne frame of the first pose, metres.
    ``source`` names each file and its SHA-256, without folders.
    """

    stamps_ns: tuple[int, ...]
    scans: ObjectScans
    T_odom_body: FloatArray
    T_world_body: FloatArray | None
    source: dict[str, str]

    def records(self) -> Iterator[Odometry | ObjectDetections | GroundTruthPose]:
        """For each scan in the order of time: odometry, detections (scores 1, no covariances), truth where known."""
        for i, stamp_ns in enumerate(self.stamps_ns):
            yield Odometry(stamp_ns, self.T_odom_body[i])
            labels = self.scans.labels[i]
            yield ObjectDetections(stamp_ns, "base_link", self.scans.positions[i], labels, np.ones(len(labels)))
            if self.T_world_body is not None:
                yield GroundTruthPose(stamp_ns, self.T_world_body[i])


def read_kitti_objects(
    *,
    detections: Path,
    odometry: Path,
    calib: Path,
    times: Path,
    ground_truth: Path | None = None,
    sequence: str | None = None,
) -> KittiObjects:
    """Read and validate one sequence.

    Args:
        detections: archive or folder with ``bow.txt`` and ``centroids/NNNNNN.txt``, metres, velodyne frame.
        odometry: estimated poses of the left camera, KITTI format.
        calib: KITTI odometry calibration; ``Tr`` maps velodyne to left camera.
        times: seconds of each scan.
        ground_truth: true poses of the left camera, same format as ``odometry``.
        sequence: name of the folder, needed only where ``detections`` holds several.

    Raises:
        DatasetError: a file that is missing or wrong, or numbers of poses, times and scans that differ.
    """
    files = {"odometry": odometry, "calib": calib, "times": times}
    if ground_truth is not None:
        files["ground_truth"] = ground_truth
    texts: dict[str, TextFile] = {role: read_text_file(path) for role, path in files.items()}
    scans = read_object_scans(detections, sequence=sequence)
    stamps_ns = parse_times(texts["times"])
    poses = {role: parse_poses(text) for role, text in texts.items() if role in ("odometry", "ground_truth")}
    counts = {
        f"{len(scans.positions)} scans in {detections.name}": len(scans.positions),
        f"{len(stamps_ns)} times in {times.name}": len(stamps_ns),
        **{f"{len(T)} poses in {files[role].name}": len(T) for role, T in poses.items()},
    }
    if len(set(counts.values())) != 1:
        raise DatasetError(f"{', '.join(counts)}: the numbers must be equal; give files of one sequence")
    if not stamps_ns:
        raise DatasetError(f"{times}: no scan in it")
    T_camera_velodyne = parse_calibration(texts["calib"])
    bodies = {role: body_poses(T, T_camera_velodyne) for role, T in poses.items()}
    source = {"dataset": "kitti-objects", "detections": scans.sequence, "detections_sha256": scans.sha256}
    for role, text in texts.items():
        source[role] = files[role].name
        source[f"{role}_sha256"] = sha256_of([text])
    return KittiObjects(tuple(stamps_ns), scans, bodies["odometry"], bodies.get("ground_truth"), source)


def import_kitti_objects(
    output: Path,
    *,
    detections: Path,
    odometry: Path,
    calib: Path,
    times: Path,
    ground_truth: Path | None = None,
    sequence: str | None = None,
) -> ImportSummary:
    """Write one sequence (see ``read_kitti_objects``) as a log with /odom, /detections and, with truth, /ground_truth.

    The metadata "source" holds each file's name and SHA-256.

    Raises:
        DatasetError: the input is missing or wrong; nothing is written then.
        UnwritableLogError: the log cannot be written.
    """
    drive = read_kitti_objects(
        detections=detections,
        odometry=odometry,
        calib=calib,
        times=times,
        ground_truth=ground_truth,
        sequence=sequence,
    )
    return write_imported_log(output, drive.records(), drive.source)
