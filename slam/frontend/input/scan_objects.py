"""From labelled scans of a LiDAR to the objects in them."""

from __future__ import annotations

import numpy as np

from logs.messages import LabelledScan, ObjectDetections
from slam.frontend.input.label_map import DROPPED, LabelMap
from slam.frontend.input.sensor_frames import SensorFrames


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
        if key not in self._found:
            self._found[key] = self._objects(scan, body_frame)
        return self._found[key]

    def _objects(self, scan: LabelledScan, body_frame: str) -> ObjectDetections:
        from logs.clouds.objects import find_objects

        numbers = [number for number in np.unique(scan.cloud.classes).tolist() if number]
        names = {number: str(number) for number in numbers if self._labels.name(str(number)) != DROPPED}
        T_body_sensor = self._frames.find(body_frame, scan.frame_id, scan.stamp_ns)
        # The cosine of the tilt is 1 for a level frame and 0 for an optical one.
        is_upright = T_body_sensor is None or abs(T_body_sensor[2, 2]) > 0.7
        objects = find_objects(scan.cloud, names, viewpoint=np.zeros(3), upright=is_upright)
        return objects.detections(scan.stamp_ns, scan.frame_id)
