"""Victoria Park (Sydney): a truck's odometry and sightings of trees whose identity is known, in the plane.

The file is the one that comes with GTSAM (``Data/victoria_park.txt``). Its lines, in the order of the drive:

* ``ODOMETRY from to dx dy dtheta`` and six numbers: the motion from one pose to the next, metres and radians in the
  frame of the first (x forward, y left), and the upper triangle of its covariance;
* ``LANDMARK pose tree x y`` and three numbers: a tree seen from that pose, metres in its frame, and the upper triangle
  of the covariance of (x, y), m^2. Poses and trees are numbered from one common sequence.
"""

from __future__ import annotations

import importlib.util
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from logs.errors import DatasetError
from logs.importers.imported_log import ImportedRecord
from logs.importers.text_files import MAX_DIGITS, describe_sources, parse_numbers, read_source_text
from logs.messages import DetectionTruth, FloatArray, ObjectDetections, Odometry

STEP_NS = 200_000_000
"""Time between poses. The file has no stamps; the laser scans to which its poses belong came about every 0.21 s."""

_FIELD_COUNTS = {"ODOMETRY": 11, "LANDMARK": 7}


@dataclass(frozen=True, slots=True, eq=False)
class Sighting:
    """A tree seen from a pose: position (3,) m in the body frame, z = 0; covariance (3, 3) m^2; which tree it was."""

    tree_id: str
    position: FloatArray
    covariance: FloatArray


@dataclass(frozen=True, slots=True, eq=False)
class VictoriaPark:
    """The drive: ``T_odom_body`` (N, 4, 4), metres, summed up from the identity, and the sightings from each pose."""

    T_odom_body: FloatArray
    sightings: tuple[tuple[Sighting, ...], ...]
    source: dict[str, str]

    def records(self) -> Iterator[ImportedRecord]:
        """Odometry for each pose; detections and their truth for each pose from which a tree was seen.

        Stamps start at 0 and are ``STEP_NS`` apart, because the file has none.
        """
        for i, sightings in enumerate(self.sightings):
            stamp_ns = i * STEP_NS
            yield Odometry(stamp_ns, self.T_odom_body[i])
            if sightings:
                positions = np.stack([sighting.position for sighting in sightings])
                covariances = np.stack([sighting.covariance for sighting in sightings])
                labels = ("tree",) * len(sightings)
                yield ObjectDetections(stamp_ns, "base_link", positions, labels, np.ones(len(labels)), covariances)
                yield DetectionTruth(stamp_ns, tuple(sighting.tree_id for sighting in sightings))


def bundled_victoria_park() -> Path:
    """The file inside the installed GTSAM, found without importing it.

    Raises:
        DatasetError: GTSAM is not installed or comes without its data.
    """
    spec = importlib.util.find_spec("gtsam")
    if spec is None or spec.origin is None:
        raise DatasetError("gtsam, with which victoria_park.txt comes, is not installed; give the file's path")
    path = Path(spec.origin).parent / "Data" / "victoria_park.txt"
    if not path.is_file():
        raise DatasetError(f"{path}: this gtsam comes without it; give the path of victoria_park.txt")
    return path


def read_victoria_park(path: Path | None = None) -> VictoriaPark:
    """Read and validate the drive at ``path``, by default the one that comes with GTSAM.

    The file is planar: z = 0 everywhere, and the vertical variance of a sighting, which it does not give, is the mean
    of its horizontal ones.

    Raises:
        DatasetError: the file is missing, or a line is damaged, out of order, or of a pose that does not exist.
    """
    file = read_source_text(bundled_victoria_park() if path is None else path)
    poses: list[FloatArray] = [np.eye(4)]
    pose_key: int | None = None
    sightings: list[list[Sighting]] = [[]]
    for number, line in file.lines():
        where = f"{file.name}, line {number}"
        tag, *fields = line.split()
        if tag not in _FIELD_COUNTS:
            raise DatasetError(f"{where}: {tag!r} is neither ODOMETRY nor LANDMARK")
        values = parse_numbers(file.name, number, fields, _FIELD_COUNTS[tag])
        first, second = _key(where, fields[0]), _key(where, fields[1])
        if first != (first if pose_key is None else pose_key):
            raise DatasetError(
                f"{where}: {tag} from pose {first}, but the drive is at pose {pose_key}; lines must stand in the order "
                "of the drive"
            )
        pose_key = first
        if tag == "ODOMETRY":
            poses.append(poses[-1] @ _planar_transform(*values[2:5]))
            sightings.append([])
            pose_key = second
        else:
            sightings[-1].append(_sighting(where, str(second), values))
    if len(poses) == 1:
        raise DatasetError(f"{file.name}: no ODOMETRY line; give GTSAM's victoria_park.txt")
    source = describe_sources("victoria-park", [("graph", file)])
    return VictoriaPark(np.stack(poses), tuple(map(tuple, sightings)), source)


def _key(where: str, text: str) -> int:
    if not (text.isdecimal() and len(text) <= MAX_DIGITS):
        raise DatasetError(f"{where}: {text!r} is not the number of a pose or tree")
    return int(text)


def _planar_transform(dx_m: float, dy_m: float, dtheta_rad: float) -> FloatArray:
    c, s = np.cos(dtheta_rad), np.sin(dtheta_rad)
    return np.array([[c, -s, 0.0, dx_m], [s, c, 0.0, dy_m], [0.0, 0.0, 1.0, 0.0], [0.0, 0.0, 0.0, 1.0]])


def _sighting(where: str, tree_id: str, values: list[float]) -> Sighting:
    x_m, y_m, xx, xy, yy = values[2:]
    if not (xx > 0.0 and xx * yy > xy * xy):
        raise DatasetError(f"{where}: covariance ({xx:g}, {xy:g}, {yy:g}) is not positive definite")
    covariance = np.array([[xx, xy, 0.0], [xy, yy, 0.0], [0.0, 0.0, 0.5 * (xx + yy)]])
    return Sighting(tree_id, np.array([x_m, y_m, 0.0]), covariance)
