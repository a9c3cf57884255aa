"""From boxes and tags in an image to objects in space: by depth, or where the ray of the foot meets the ground.

Pixels are u to the right and v down; a camera's frame is the optical one: x right, y down, z forward (REP 103).
"""

from collections import Counter, deque
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from logs.messages import CameraModel, DepthImage, ImageDetections, ObjectDetections
from slam.common.arrays import FloatArray
from slam.common.calibration import DetectionCalibration
from slam.common.geometry import invert
from slam.frontend.input.sensor_frames import SensorFrames

BOX_SIGMA = 1.0 / 6.0
"""Of the sides of a box: two sigmas are the shift, a third of a side, at which a box counts as wrong (IoU 0.5)."""

_Object = tuple[FloatArray, FloatArray]


class ImageLifter:
    """Places what cameras see. ``counters`` tells why some could not be placed."""

    def __init__(self, config: DetectionCalibration, frames: SensorFrames) -> None:
        self._config = config
        self._frames = frames
        self._cameras: dict[str, CameraModel] = {}
        self._depths: dict[str, deque[DepthImage]] = {}
        self.body_frame = ""
        self.counters: Counter[str] = Counter()

    def add(self, record: CameraModel | DepthImage) -> None:
        """Store the projection of a camera, or a depth image, for later detections in its frame."""
        if isinstance(record, CameraModel):
            self._cameras[record.frame_id] = record
        else:
            self._depths.setdefault(record.frame_id, deque(maxlen=10)).append(record)

    def lift(self, detections: ImageDetections) -> ObjectDetections:
        """The detections that can be placed, in the camera's frame, with covariances that are long along the ray."""
        found = [self._place(detections, i) for i in range(len(detections.labels))]
        self.counters.update(each for each in found if isinstance(each, str))
        placed = {i: each for i, each in enumerate(found) if isinstance(each, tuple)}
        return ObjectDetections(
            detections.stamp_ns,
            detections.frame_id,
            np.array([position for position, _ in placed.values()]).reshape(-1, 3),
            tuple(detections.labels[i] for i in placed),
            detections.scores[[*placed]],
            np.array([covariance for _, covariance in placed.values()]).reshape(-1, 3, 3),
        )

    def _place(self, detections: ImageDetections, i: int) -> _Object | str | None:
        """The object, or why it cannot be placed; None where a tag is degenerate."""
        if detections.corners is not None:
            T_camera_tag = self._frames.find(detections.frame_id, detections.labels[i], detections.stamp_ns)
            if T_camera_tag is not None:
                return T_camera_tag[:3, 3], np.zeros((3, 3))
        camera = self._cameras.get(detections.frame_id)
        if camera is None:
            return "objects_without_camera_info"
        if detections.corners is not None:
            if not self._config.tag_size_m:
                return "objects_without_tag_size"
            return place_tag(camera, detections.corners[i], self._config.tag_size_m)
        depth = self._depth_at(detections)
        placed = None if depth is None else place_by_depth(camera, detections.boxes[i], depth.depths)
        T_body_camera = self._frames.find(self.body_frame, detections.frame_id, detections.stamp_ns)
        if placed is None and T_body_camera is not None:
            placed = place_on_ground(
                camera, detections.boxes[i], T_body_camera, self._config.ground_z_m, self._config.reach_m
            )
        return "objects_without_depth" if placed is None else placed

    def _depth_at(self, detections: ImageDetections) -> DepthImage | None:
        """The image with the stamp of the detections, else the nearest, if that is no farther than images are apart."""
        kept = self._depths.get(detections.frame_id, ())
        apart_ns = min((abs(b.stamp_ns - a.stamp_ns) for a, b in pairwise(kept)), default=0)
        near = [each for each in kept if abs(each.stamp_ns - detections.stamp_ns) <= apart_ns]
        return min(near, key=lambda each: abs(each.stamp_ns - detections.stamp_ns), default=None)


def ray(camera: CameraModel, u: float, v: float) -> FloatArray:
    """``(3,)`` direction of a pixel in the frame of the camera, with z = 1."""
    xy = np.array([(u - camera.K[0, 2]) / camera.K[0, 0], (v - camera.K[1, 2]) / camera.K[1, 1]])
    if camera.distortion.any():
        given = xy.copy()
        for _ in range(20):
            xy = xy + given - _distorted(camera, xy)
    return np.array([xy[0], xy[1], 1.0])


def _distorted(camera: CameraModel, xy: FloatArray) -> FloatArray:
    """Projection of directions: OpenCV's models, by their names in ROS."""
    x, y = xy.tolist()
    if camera.model in ("equidistant", "fisheye"):
        k = np.concatenate([camera.distortion, np.zeros(4)])[:4]
        r = float(np.hypot(x, y))
        if r == 0.0:
            return xy
        angle = float(np.arctan(r))
        powers = angle ** np.array([2, 4, 6, 8])
        return xy * (angle * (1.0 + float(k @ powers)) / r)
    k1, k2, p1, p2, k3, k4, k5, k6 = np.concatenate([camera.distortion, np.zeros(8)])[:8].tolist()
    r2 = x * x + y * y
    radial = (1.0 + r2 * (k1 + r2 * (k2 + r2 * k3))) / (1.0 + r2 * (k4 + r2 * (k5 + r2 * k6)))
    return np.array(
        [
            x * radial + 2.0 * p1 * x * y + p2 * (r2 + 2.0 * x * x),
            y * radial + p1 * (r2 + 2.0 * y * y) + 2.0 * p2 * x * y,
        ]
    )


def place_by_depth(camera: CameraModel, box: FloatArray, depths: NDArray[np.floating]) -> _Object | None:
    """Position (3,) m of the object in ``box`` (centre u, v, width, height), and its covariance (3, 3).

    The depth is the median of the nearer half of the inner quarter of the box: what is behind an object is farther.
    None where there is no depth.
    """
    u, v, width, height = box.tolist()
    rows, columns = (
        slice(max(round(middle - side / 4), 0), max(round(middle + side / 4) + 1, 0))
        for middle, side in ((v, height), (u, width))
    )
    inside = depths[rows, columns]
    inside = np.sort(inside[np.isfinite(inside)])
    if not len(inside):
        return None
    nearer = inside[: len(inside) // 2 + 1].astype(np.float64)
    depth = float(np.median(nearer))
    direction = ray(camera, u, v)
    spread = 1.4826 * np.median(np.abs(nearer - depth))
    lateral = np.array([width / camera.K[0, 0], height / camera.K[1, 1]]) * depth * BOX_SIGMA
    # An object is about as deep as it is wide, and its centre is behind what is seen of it.
    along = np.hypot(spread, lateral[0] / BOX_SIGMA / 4.0)
    return depth * direction, _long_along(direction, along, lateral)


def place_on_ground(
    camera: CameraModel, box: FloatArray, T_body_camera: FloatArray, ground_z_m: float, max_range_m: float
) -> _Object | None:
    """Where the foot of ``box`` stands on the plane z = ``ground_z_m`` of the body: position and covariance in the
    frame of the camera. None where the foot is above the horizon or beyond ``max_range_m``.
    """
    u, v, width, height = box.tolist()
    foot = np.array([u, v + height / 2])
    R, origin = T_body_camera[:3, :3], T_body_camera[:3, 3]

    def meet(pixel: FloatArray) -> FloatArray | None:
        direction = R @ ray(camera, *pixel)
        way = (ground_z_m - origin[2]) / direction[2] if direction[2] else -1.0
        return origin + way * direction if way > 0.0 else None

    point = meet(foot)
    if point is None or np.linalg.norm(point) > max_range_m:
        return None
    sigmas = np.array([width, height]) * BOX_SIGMA
    # Downwards, where the ray always meets the ground.
    moved = [meet(foot + step) for step in np.diag(sigmas)]
    steps = [other - point for other in moved if other is not None]
    covariance = sum((np.outer(step, step) for step in steps), np.zeros((3, 3)))
    covariance[2, 2] += np.min([step @ step for step in steps])
    T_camera_body = invert(T_body_camera)
    return T_camera_body[:3, :3] @ point + T_camera_body[:3, 3], R.T @ covariance @ R


def place_tag(camera: CameraModel, corners: FloatArray, size_m: float) -> _Object | None:
    """Position (3,) m of a square tag with sides of ``size_m`` whose ``corners`` (4, 2) are seen, and its covariance.

    From the homography between the tag and its image (Zhang 2000, section 3.1). None where it is degenerate.
    """
    square = 0.5 * size_m * np.array([[-1.0, 1.0], [1.0, 1.0], [1.0, -1.0], [-1.0, -1.0]])
    rows = []
    for place, corner in zip(square, corners.tolist(), strict=True):
        a, b, _ = ray(camera, *corner).tolist()
        rows.append(np.kron([[1.0, 0.0, -a], [0.0, 1.0, -b]], [*place, 1.0]))
    H = np.linalg.svd(np.concatenate(rows))[2][-1].reshape(3, 3)
    scale = 0.5 * (np.linalg.norm(H[:, 0]) + np.linalg.norm(H[:, 1]))
    position = H[:, 2] / scale if scale > 0.0 else np.zeros(3)
    position = position * np.sign(position[2])
    side_px = np.linalg.norm(np.roll(corners, -1, axis=0) - corners, axis=1).mean()
    if not (position[2] > 0.0 and side_px > 0.0 and np.isfinite(position).all()):
        return None
    sigma_px = 0.5  # corners are found to fractions of a pixel
    lateral = np.full(2, position[2] * sigma_px / camera.K[0, 0])
    return position, _long_along(position, np.linalg.norm(position) * sigma_px / side_px, lateral)


def _long_along(direction: FloatArray, along_m: float, lateral_m: FloatArray) -> FloatArray:
    """Covariance (3, 3): ``along_m`` along the direction, ``lateral_m`` (2,) to the right and downwards."""
    forward = direction / np.linalg.norm(direction)
    right = np.cross([0.0, 1.0, 0.0], forward)
    right /= np.linalg.norm(right)
    axes = np.stack([right, np.cross(forward, right), forward], axis=1)
    return axes @ np.diag([lateral_m[0], lateral_m[1], along_m]) ** 2 @ axes.T
