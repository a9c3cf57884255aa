"""Objects in images, placed by depth, on the ground, or by the size of tags."""

import numpy as np
import pytest

from logs.messages import CameraModel, DepthImage, ImageDetections, Odometry, Transform
from slam.common.calibration import DetectionCalibration
from slam.common.config import Config, LabelsConfig
from slam.common.errors import InputDataError
from slam.common.geometry import apply, invert, make_transform
from slam.frontend.input.image_detections import (
    ImageLifter,
    _distorted,
    place_by_depth,
    place_on_ground,
    place_tag,
    ray,
)
from slam.frontend.input.input_records import InputRecords
from slam.frontend.input.label_map import LabelMap
from slam.frontend.input.sensor_frames import SensorFrames
from tests.helpers.poses import motion_by

K = np.array([[500.0, 0.0, 320.0], [0.0, 510.0, 240.0], [0.0, 0.0, 1.0]])
PINHOLE = CameraModel(0, "camera", K, np.zeros(5), "plumb_bob")
R_body_optical = np.array([[0.0, 0.0, 1.0], [-1.0, 0.0, 0.0], [0.0, -1.0, 0.0]])
T_body_camera = make_transform(R_body_optical, np.array([0.2, 0.1, 1.5]))


def project(points: np.ndarray) -> np.ndarray:
    """Pixels (N, 2) of points in the frame of the camera."""
    return (points / points[:, 2:]) @ K.T[:, :2]


def sigma_along(covariance: np.ndarray, direction: np.ndarray) -> float:
    unit = direction / np.linalg.norm(direction)
    return float(np.sqrt(unit @ covariance @ unit))


@pytest.mark.parametrize(
    ("model", "distortion"),
    [
        ("plumb_bob", (-0.3, 0.1, 0.001, -0.002, 0.0)),
        ("equidistant", (0.01, -0.02, 0.0, 0.0)),
        ("rational_polynomial", (0.1, 0.05, 0.0, 0.0, 0.01, 0.2, 0.01, 0.0)),
    ],
)
def test_a_distorted_pixel_leads_back_to_its_direction(model: str, distortion: tuple[float, ...]) -> None:
    camera = CameraModel(0, "camera", K, np.array(distortion), model)
    direction = np.array([0.45, -0.22])
    if model == "plumb_bob":
        r2 = float(direction @ direction)
        radial = 1.0 - 0.3 * r2 + 0.1 * r2 * r2
        x, y = direction
        expected = [
            x * radial + 2 * 0.001 * x * y - 0.002 * (r2 + 2 * x * x),
            y * radial + 0.001 * (r2 + 2 * y * y) - 2 * 0.002 * x * y,
        ]
        np.testing.assert_allclose(_distorted(camera, direction), expected, atol=1e-15)
    u, v = K[:2, :2] @ _distorted(camera, direction) + K[:2, 2]
    np.testing.assert_allclose(ray(camera, u, v)[:2], direction, atol=1e-6)
    assert np.abs(ray(PINHOLE, u, v)[:2] - direction).max() > 1e-3


def test_an_object_is_at_the_depth_of_what_is_near_in_its_box() -> None:
    depths = np.full((480, 640), 30.0, dtype=np.float32)
    depths[200:280, 300:330] = 8.0
    depths[230:235] = np.nan
    placed = place_by_depth(PINHOLE, np.array([310.0, 240.0, 60.0, 80.0]), depths)
    position, covariance = placed
    np.testing.assert_allclose(position, 8.0 * ray(PINHOLE, 310.0, 240.0), atol=1e-9)
    across = sigma_along(covariance, np.eye(3)[0])
    assert sigma_along(covariance, position) > 1.2 * across > 0.1
    assert place_by_depth(PINHOLE, np.array([310.0, 240.0, 60.0, 80.0]), np.full((480, 640), np.nan)) is None
    assert place_by_depth(PINHOLE, np.array([-90.0, 240.0, 60.0, 80.0]), depths) is None


def test_a_foot_on_the_ground_tells_the_distance() -> None:
    foot = np.array([12.0, -2.0, -0.1])
    camera_foot = apply(invert(T_body_camera), foot[None])
    u, v = project(camera_foot)[0]
    box = np.array([u, v - 30.0, 20.0, 60.0])
    placed = place_on_ground(PINHOLE, box, T_body_camera, -0.1, 80.0)
    position, covariance = placed
    np.testing.assert_allclose(position, camera_foot[0], atol=1e-9)
    across = sigma_along(covariance, np.eye(3)[0])
    assert sigma_along(covariance, position) > 5.0 * across > 0.0
    assert np.linalg.eigvalsh(covariance).min() > 0.0
    above = np.array([u, 100.0, 20.0, 60.0])
    assert place_on_ground(PINHOLE, above, T_body_camera, -0.1, 80.0) is None
    assert place_on_ground(PINHOLE, box, T_body_camera, -0.1, 10.0) is None


@pytest.mark.parametrize("turned", [0.0, 0.5])
def test_a_tag_of_known_size(turned: float) -> None:
    square = 0.08 * np.array([[-1.0, 1.0, 0.0], [1.0, 1.0, 0.0], [1.0, -1.0, 0.0], [-1.0, -1.0, 0.0]])
    center = np.array([0.3, -0.2, 2.5])
    placed = place_tag(PINHOLE, project(apply(motion_by([0.0, turned, 0.0], center), square)), 0.16)
    position, covariance = placed
    np.testing.assert_allclose(position, center, atol=1e-9)
    assert sigma_along(covariance, center) > 5.0 * sigma_along(covariance, np.eye(3)[0])
    assert place_tag(PINHOLE, np.zeros((4, 2)), 0.16) is None
    blurred, _ = place_tag(PINHOLE, project(square * [0.9, 1.1, 1.0] + center), 0.16)
    np.testing.assert_allclose(blurred, center, rtol=1e-9)


def boxes(stamp_ns: int = 100, frame: str = "camera") -> ImageDetections:
    box = np.array([[310.0, 240.0, 60.0, 80.0], [320.0, 20.0, 30.0, 20.0]])
    return ImageDetections(stamp_ns, frame, box, ("tree", "bird"), np.array([0.9, 0.8]))


def lifter(**settings: float) -> ImageLifter:
    frames = SensorFrames()
    frames.add(Transform(0, "base_link", "camera", T_body_camera))
    found = ImageLifter(DetectionCalibration(**settings), frames)
    found.body_frame = "base_link"
    return found


def depth_image(stamp_ns: int, depth: float) -> DepthImage:
    return DepthImage(stamp_ns, "camera", np.full((480, 640), depth, dtype=np.float32))


def test_depth_is_taken_at_the_stamp_and_the_ground_where_there_is_none() -> None:
    found = lifter()
    found.add(PINHOLE)
    on_ground = found.lift(boxes())
    assert (on_ground.labels, on_ground.frame_id) == (("tree",), "camera")
    assert found.counters == {"objects_without_depth": 1}
    for stamp_ns, depth in ((90, 3.0), (100, 4.0), (110, 5.0)):
        found.add(depth_image(stamp_ns, depth))
    assert found.lift(boxes()).positions[:, 2].tolist() == [4.0, 4.0]
    assert found.lift(boxes(104)).positions[:, 2].tolist() == [4.0, 4.0]
    np.testing.assert_array_equal(found.lift(boxes(200)).positions, on_ground.positions)


def test_a_tag_is_where_tf_says_else_as_far_as_its_size_tells() -> None:
    corners = project(0.08 * np.array([[-1, 1, 0], [1, 1, 0], [1, -1, 0], [-1, -1, 0]]) + np.array([0.0, 0.0, 2.0]))
    tag = ImageDetections(100, "camera", np.ones((1, 4)), ("tag36h11:5",), np.ones(1), corners[None])
    found = lifter()
    found.add(PINHOLE)
    assert found.lift(tag).labels == ()
    assert found.counters == {"objects_without_tag_size": 1}
    sized = lifter(tag_size_m=0.16)
    sized.add(PINHOLE)
    np.testing.assert_allclose(sized.lift(tag).positions, [[0.0, 0.0, 2.0]], atol=1e-9)
    told = lifter()
    T_camera_tag = make_transform(np.eye(3), np.array([0.1, 0.2, 3.0]))
    told._frames.add(Transform(100, "camera", "tag36h11:5", T_camera_tag))
    placed = told.lift(tag)
    np.testing.assert_array_equal(placed.positions, [[0.1, 0.2, 3.0]])
    assert not placed.covariances.any()


def test_objects_in_images_are_prepared_for_the_mapper() -> None:
    config = Config(labels=LabelsConfig(drop=("bird",)))
    inputs = InputRecords(config, LabelMap(config.labels), lifter()._frames)
    _, placed = inputs.prepare([Odometry(1, np.eye(4)), boxes()])
    assert placed.positions.shape == (0, 3)
    with pytest.raises(InputDataError, match=r"none of 2 objects in images of camera.*no CameraInfo has their frame"):
        inputs.check()
    (placed,) = inputs.prepare([PINHOLE, depth_image(100, 4.0), boxes()])
    assert placed.labels == ("tree", "")
    inputs.check()
    assert inputs.counters == {"objects_without_camera_info": 2}
