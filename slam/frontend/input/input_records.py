"""The records of a log as the mapper takes them: objects in three dimensions, under their names in the map."""

from collections import Counter
from collections.abc import Iterable, Iterator

import numpy as np

from logs.messages import CameraModel, DepthImage, ImageDetections, LabelledScan, ObjectDetections, Odometry, Record
from slam.common.arrays import FloatArray
from slam.common.config import Config
from slam.common.errors import InputDataError
from slam.frontend.input.image_detections import ImageLifter
from slam.frontend.input.label_map import DROPPED, LabelMap
from slam.frontend.input.sensor_frames import SensorFrames

_REMEDIES = {
    "objects_without_camera_info": "no CameraInfo has their frame: record it, or choose it with "
    "--topic camera_info=/topic",
    "objects_without_tag_size": "their size is not known: --set calibration.detection.tag_size_m, or record the /tf of "
    "their poses",
    "objects_without_depth": "no depth image has their frame (--topic depth=/topic), and their lower edges do not "
    "meet the ground in view (/tf from the body to the camera, calibration.detection.ground_z_m)",
}


class InputRecords:
    """Prepares the records of one pass over a log."""

    def __init__(
        self, config: Config, labels: LabelMap, frames: SensorFrames, scans: "ScanObjects | None" = None
    ) -> None:
        """``scans``: those whose objects another pass has found."""
        self._labels = labels
        self._scans = scans or ScanObjects(labels, frames)
        self._lifter = ImageLifter(config.calibration.detection, frames)
        self._frame = ""
        self._placed = 0
        self._repeated = Counter[str]()
        self._latest: dict[str, tuple[ObjectDetections, FloatArray | None]] = {}
        self._T_odom_body: FloatArray | None = None

    @property
    def counters(self) -> Counter[str]:
        """Objects in images that could not be placed, by the reason, and ``detections_repeated``: scans left out."""
        return self._lifter.counters + self._repeated

    def prepare(self, records: Iterable[Record]) -> Iterator[Record]:
        """The records to map, without those that only help to place others."""
        return (prepared for prepared in map(self._prepared, records) if prepared is not None)

    def _prepared(self, record: Record) -> Record | None:
        if isinstance(record, (CameraModel, DepthImage)):
            self._lifter.add(record)
            return None
        if isinstance(record, ImageDetections):
            self._frame = record.frame_id
            record = self._lifter.lift(record)
            self._placed += len(record.labels)
        elif isinstance(record, LabelledScan):
            record = self._scans.find(record, self._lifter.body_frame)
        elif isinstance(record, Odometry):
            self._lifter.body_frame = record.child_frame_id
            self._T_odom_body = record.T_odom_body
        if not isinstance(record, ObjectDetections):
            return record
        if self._repeats(record):
            self._repeated["detections_repeated"] += 1
            return None
        return self._labels.apply(record)

    def _repeats(self, scan: ObjectDetections) -> bool:
        """Whether a scan has the objects of the one before from its sensor to the last digit, though the body moved:
        nobody looked again.
        """
        before, T_before = self._latest.get(scan.frame_id, (scan, None))
        self._latest[scan.frame_id] = scan, self._T_odom_body
        return (
            before.stamp_ns != scan.stamp_ns
            and len(scan.positions) > 0
            and np.array_equal(before.positions, scan.positions)
            and T_before is not None
            and self._T_odom_body is not None
            and not np.array_equal(T_before, self._T_odom_body)
        )

    def check(self) -> None:
        """Refuse a log whose objects are all in images and could not be placed.

        Raises:
            InputDataError: with the most frequent reason and the remedy.
        """
        if self._lifter.counters and not self._placed:
            ((reason, count),) = self._lifter.counters.most_common(1)
            raise InputDataError(
                f"none of {self._lifter.counters.total()} objects in images of {self._frame or 'a camera'} could be "
                f"placed; of {count}, {_REMEDIES[reason]}"
            )


class ScanObjects:
    """Finds the objects of each scan once, in however many passes over a log.

    Classes are called by their numbers; those that the settings drop are not looked for.
    """

    def __init__(self, labels: LabelMap, frames: SensorFrames) -> None:
        self._labels = labels
        self._frames = frames
        self._found: dict[tuple[str, int], ObjectDetections] = {}

    def find(self, scan: LabelledScan, body_frame: str) -> ObjectDetections:
        """The objects of ``scan``, in its frame.

        Raises:
            DatasetError: Open3D is missing.
        """
        key = (scan.frame_id, scan.stamp_ns)
        if key in self._found:
            return self._found[key]
        from logs.clouds.objects import find_objects

        numbers = [number for number in np.unique(scan.cloud.classes).tolist() if number]
        names = {number: str(number) for number in numbers if self._labels.name(str(number)) != DROPPED}
        T_body_sensor = self._frames.find(body_frame, scan.frame_id, scan.stamp_ns)
        # The cosine of the tilt is 1 for a level frame and 0 for an optical one.
        is_upright = T_body_sensor is None or abs(T_body_sensor[2, 2]) > 0.7
        objects = find_objects(scan.cloud, names, viewpoint=np.zeros(3), upright=is_upright)
        found = self._found[key] = objects.detections(scan.stamp_ns, scan.frame_id)
        return found
