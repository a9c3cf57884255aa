"""Poses of the sensors on the body, from the transforms of a log, interpolated in time."""

from bisect import bisect_left
from collections.abc import Iterable
from functools import lru_cache
from graphlib import CycleError, TopologicalSorter
from itertools import pairwise

import numpy as np
from scipy.spatial.transform import Rotation

from logs.messages import ObjectDetections, Odometry, Transform
from slam.common.arrays import FloatArray
from slam.common.calibration import DetectionCalibration
from slam.common.errors import InputDataError
from slam.common.geometry import blend, invert, make_transform

_Edge = tuple[str, str]


class SensorFrames:
    """The frames of a log and the transforms between them. A leading slash of a name, as in ROS 1, does not matter."""

    def __init__(self) -> None:
        self._tracks: dict[_Edge, _Track] = {}
        self._neighbours: dict[str, list[str]] = {}
        self._chains: dict[_Edge, list[str]] = {}  # of frames from the first to the last, empty where none leads there

    def add(self, transform: Transform) -> None:
        """Store a transform; a later one between the same frames replaces it from its stamp on."""
        parent, child = _plain(transform.parent_frame_id), _plain(transform.child_frame_id)
        if parent == child:
            return
        track = self._tracks.get((parent, child))
        if track is None:
            track = self._tracks[parent, child] = _Track()
            self._neighbours.setdefault(parent, []).append(child)
            self._neighbours.setdefault(child, []).append(parent)
            self._chains.clear()
        track.add(transform.stamp_ns, transform.T_parent_child)

    def find(self, body_frame: str, sensor_frame: str, stamp_ns: int | None = None) -> FloatArray | None:
        """``T_body_sensor`` (4, 4) along the shortest chain of transforms; None if nothing connects the two.

        Each transform is that at ``stamp_ns``: between two stamps interpolated, before the first and after the last
        held; the latest one for None.

        Raises:
            InputDataError: the transforms around the body form a loop.
        """
        start, end = _plain(body_frame), _plain(sensor_frame)
        if (start, end) not in self._chains:
            came_from = self._search(start)
            self._refuse_loop(came_from)
            chain = [end] if end in came_from else []
            while chain and chain[0] != start:
                chain.insert(0, came_from[chain[0]])
            self._chains[start, end] = chain
        chain = self._chains[start, end]
        if not chain:
            return None
        T_body_frame = np.eye(4)
        for frame, following in pairwise(chain):
            if (frame, following) in self._tracks:
                T_body_frame = T_body_frame @ self._tracks[frame, following].at(stamp_ns)
            else:
                T_body_frame = T_body_frame @ invert(self._tracks[following, frame].at(stamp_ns))
        return T_body_frame

    def tree_of(self, frame: str) -> tuple[str, ...]:
        """All frames that transforms connect with ``frame``, sorted; it alone where there are none."""
        return tuple(sorted(self._search(_plain(frame))))

    def _search(self, start: str) -> dict[str, str]:
        """Frame -> the frame before it on the shortest way from ``start``, for all that are connected with it."""
        came_from, reached = {start: start}, [start]
        for frame in reached:  # which grows meanwhile
            for neighbour in self._neighbours.get(frame, ()):
                if neighbour not in came_from:
                    came_from[neighbour] = frame
                    reached.append(neighbour)
        return came_from

    def _refuse_loop(self, connected: Iterable[str]) -> None:
        parents: dict[str, list[str]] = {frame: [] for frame in connected}
        for parent, child in self._tracks:
            if child in parents:
                parents[child].append(parent)
        try:
            TopologicalSorter(parents).prepare()
        except CycleError as error:
            raise InputDataError(
                f"the transforms form a loop: {' -> '.join(error.args[1])}, so the poses of sensors on the body are "
                "undefined; find the node that publishes a wrong transform, and remove it from the log"
            ) from error


def find_sensor(
    frames: SensorFrames,
    detections: ObjectDetections,
    odometry: Odometry,
    T_odom_body: FloatArray,
    config: DetectionCalibration,
) -> FloatArray | None:
    """``T_body_sensor`` (4, 4) for detections at the pose ``T_odom_body`` (4, 4) in the frame of the odometry's
    messages, corrected as the settings say.

    Detections in the frame of the odometry need no transform, as the odometry itself connects it with the body. None
    where nothing connects their frame with either; ``odometry`` names both frames.
    """
    frame, body_frame = _plain(detections.frame_id), _plain(odometry.child_frame_id)
    odometry_frame = _plain(odometry.frame_id)
    if config.assume_odometry_frame:
        return invert(T_odom_body)
    if frame in ("", body_frame) or config.assume_body_frame:
        return corrected_mount(np.eye(4), config)
    if frame != odometry_frame and (T_body_sensor := frames.find(body_frame, frame, detections.stamp_ns)) is not None:
        return corrected_mount(T_body_sensor, config)
    T_odom_frame = frames.find(odometry_frame, frame, detections.stamp_ns)
    return None if T_odom_frame is None else invert(T_odom_body) @ T_odom_frame


class _Track:
    """The transforms between two frames by time."""

    def __init__(self) -> None:
        self._stamps_ns: list[int] = []
        self._transforms: list[FloatArray] = []

    def add(self, stamp_ns: int, T: FloatArray) -> None:
        place = bisect_left(self._stamps_ns, stamp_ns)
        stands_still = len(self._stamps_ns) >= 2 and all(np.array_equal(each, T) for each in self._transforms[-2:])
        if place < len(self._stamps_ns) and self._stamps_ns[place] == stamp_ns:
            self._transforms[place] = T
        elif place == len(self._stamps_ns) and stands_still:
            self._stamps_ns[-1] = stamp_ns  # two are enough
        else:
            self._stamps_ns.insert(place, stamp_ns)
            self._transforms.insert(place, T)

    def at(self, stamp_ns: int | None) -> FloatArray:
        if stamp_ns is None:
            return self._transforms[-1]
        after = bisect_left(self._stamps_ns, stamp_ns)
        if after in (0, len(self._stamps_ns)):
            return self._transforms[min(after, len(self._stamps_ns) - 1)]
        start, end = self._transforms[after - 1 : after + 1]
        if np.array_equal(start, end):
            return end
        start_ns, end_ns = self._stamps_ns[after - 1 : after + 1]
        return blend(start, end, (stamp_ns - start_ns) / (end_ns - start_ns))


def _plain(frame: str) -> str:
    return frame.lstrip("/")


def corrected_mount(T_body_sensor: FloatArray, config: DetectionCalibration) -> FloatArray:
    """``T_body_sensor`` (4, 4) with the sensor turned where it sits and shifted, both in the axes of the body."""
    angles_deg = (config.roll_deg, config.pitch_deg, config.yaw_deg)
    return _corrected(T_body_sensor.tobytes(), angles_deg, config.x_m, config.y_m)


@lru_cache
def _corrected(mount: bytes, angles_deg: tuple[float, ...], x_m: float, y_m: float) -> FloatArray:
    """The corrected mount (4, 4), read-only, of one given by its bytes; kept, as the same mount serves many scans."""
    T_body_sensor = np.frombuffer(mount).reshape(4, 4)
    R = Rotation.from_euler("xyz", angles_deg, degrees=True).as_matrix()
    T = make_transform(R @ T_body_sensor[:3, :3], T_body_sensor[:3, 3] + [x_m, y_m, 0.0])
    T.flags.writeable = False
    return T
