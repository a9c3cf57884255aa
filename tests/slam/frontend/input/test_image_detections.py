"""Objects in images, placed by depth, on the ground, or by the size of tags."""

import numpy as np
import pytest

from logs.messages import CameraModel, DepthImage, ImageDetections, Odometry, Transform
from slam.common.calibration import DetectionCalibration
from slam.common.config import Config, LabelsConfig
from slam.common.errors import InputDataError
from slam.common.geometry import apply, make_transform
from slam.frontend.input.image_detections import ImageLifter, place_by_depth, place_on_ground, place_tag, ray
from slam.frontend.input.input_records import InputRecords
from slam.frontend.input.label_map import LabelMap
from slam.frontend.input.sensor_frames import SensorFrames
from tests.helpers.poses import motion_by

K = np.array([[500.0, 0.0, 320.0], [0.0, 510.0, 240.0], [0.0, 0.0, 1.0]])
PINHOLE = CameraModel(0, "camera", K, np.zeros(5), "plumb_bob")
R_body_optical = np.array([[0.0, 0.0, 1.0], [-1.0, 0.0, 0.0], [0.0, -1.0, 0.0]])
T_body_camera = make_transform(R_body_optical, np.array([0.2, 0.1, 1.5]))
BOX = np.array([310.0, 240.0, 60.0, 80.0])
TAG = 0.08 * np.array([[-1.0, 1.0, 0.0], [1.0, 1.0, 0.0], [1.0, -1.0, 0.0], [-1.0, -1.0, 0.0]])


def project(points: np.ndarray) -> np.ndarray:
    """Pixels (N, 2) of points in the frame of the camera."""
    return (points / points[:, 2:]) @ K.T[:, :2]


def sigma_along(covariance: np.ndarray, direction: np.ndarray) -> float:
    unit = direction / np.linalg.norm(direction)
    return float(np.sqrt(unit @ covariance @ unit))


@pytest.mark.parametrize(
    ("model", "distortion"),
    [
        ("equidistant", (0.01, -0.02, 0.03, -0.01)),
        ("rational_polynomial", (0.1, 0.05, 0.001, -0.002, 0.01, 0.2, 0.01, 0.02)),
    ],
)
def test_ray_undoes_the_distortion_of_opencv(model: str, distortion: tuple[float, ...]) -> None:
    camera = CameraModel(0, "camera", K, np.array(distortion), model)
    direction = np.array([0.45, -0.22])
    r = float(np.hypot(*direction))
    if model == "equidistant":
        angle = np.arctan(r)
        expected = direction / r * angle * np.polyval([*distortion[::-1], 1.0], angle**2)
    else:
        k1, k2, p1, p2, k3, k4, k5, k6 = distortion
        radial = np.polyval([k3, k2, k1, 1.0], r**2) / np.polyval([k6, k5, k4, 1.0], r**2)
        x, y = direction
        shift = [2 * p1 * x * y + p2 * (r**2 + 2 * x**2), p1 * (r**2 + 2 * y**2) + 2 * p2 * x * y]
        expected = direction * radial + shift
    u, v = K[:2, :2] @ expected + K[:2, 2]
    np.testing.assert_allclose(ray(camera, u, v), [*direction, 1.0], atol=1e-6)
    np.testing.assert_allclose(ray(camera, *K[:2, 2]), [0.0, 0.0, 1.0])


def assert_errs_by(covariance: np.ndarray, position: np.ndarray, lateral_m: list[float], along_m: float) -> None:
    """Standard deviations to the right of the ray to a position and below it, and along it."""
    right = np.cross([0.0, 1.0, 0.0], position)
    axes = right, np.cross(position, right), position
    np.testing.assert_allclose([sigma_along(covariance, axis) for axis in axes], [*lateral_m, along_m])


def test_place_by_depth_takes_the_median_of_the_nearer_half_of_the_inner_quarter() -> None:
    depths = np.random.default_rng(0).uniform(5.0, 30.0, (480, 640))
    depths[230] = np.nan
    position, covariance = place_by_depth(PINHOLE, BOX, depths)
    nearer = np.sort(depths[220:261, 295:326], axis=None)[: 40 * 31 // 2 + 1]  # without what is unknown
    depth = float(np.median(nearer))
    np.testing.assert_allclose(position, depth * ray(PINHOLE, 310.0, 240.0))
    spread = 1.4826 * np.median(np.abs(nearer - depth))
    width, height = depth * 60.0 / 500.0, depth * 80.0 / 510.0
    assert_errs_by(covariance, position, [width / 6.0, height / 6.0], np.hypot(spread, width / 4.0))
    at_the_corner, _ = place_by_depth(PINHOLE, np.array([2.0, 3.0, 60.0, 80.0]), depths)
    assert at_the_corner[2] == pytest.approx(np.median(np.sort(depths[:24, :18], axis=None)[: 24 * 18 // 2 + 1]))
    assert place_by_depth(PINHOLE, BOX, np.full((480, 640), np.nan)) is None


def test_place_on_ground_tells_where_a_foot_stands_and_how_far_its_pixel_errs() -> None:
    x, y, below = 11.8, -2.1, 1.6  # from the camera
    u, v = 320.0 - 500.0 * y / x, 240.0 + 510.0 * below / x
    box = np.array([u, v - 30.0, 20.0, 60.0])
    position, covariance = place_on_ground(PINHOLE, box, T_body_camera, -0.1, 80.0)
    np.testing.assert_allclose(R_body_optical @ position, [x, y, -below], atol=1e-9)
    beside = np.array([0.0, -20.0 / 6.0 / 500.0 * x, 0.0])
    nearer = (510.0 * below / (v - 240.0 + 60.0 / 6.0) / x - 1.0) * np.array([x, y, 0.0])
    expected = np.outer(beside, beside) + np.outer(nearer, nearer)
    expected[2, 2] = min(beside @ beside, nearer @ nearer)
    np.testing.assert_allclose(R_body_optical @ covariance @ R_body_optical.T, expected, atol=1e-12)
    assert place_on_ground(PINHOLE, np.array([u, 209.9, 20.0, 60.0]), T_body_camera, -0.1, 1e9) is None
    assert place_on_ground(PINHOLE, box, T_body_camera, -0.1, 10.0) is None


@pytest.mark.parametrize("turned", [0.0, 0.5])
def test_place_tag_finds_a_tag_of_known_size(turned: float) -> None:
    center = np.array([0.3, -0.2, 2.5])
    corners = project(apply(motion_by([0.0, turned, 0.0], center), TAG))
    position, covariance = place_tag(PINHOLE, corners, 0.16)
    np.testing.assert_allclose(position, center, atol=1e-9)
    side_px = np.mean([np.linalg.norm(corners[i] - corners[i - 1]) for i in range(4)])
    along_m = np.linalg.norm(center) * 0.5 / side_px
    assert_errs_by(covariance, position, [2.5 * 0.5 / 500.0] * 2, along_m)
    assert place_tag(PINHOLE, np.zeros((4, 2)), 0.16) is None
    blurred, _ = place_tag(PINHOLE, project(TAG * [0.9, 1.1, 1.0] + center), 0.16)
    np.testing.assert_allclose(blurred, center, rtol=1e-9)


def boxes(stamp_ns: int = 100) -> ImageDetections:
    found = np.stack([BOX, [320.0, 20.0, 30.0, 20.0]])
    return ImageDetections(stamp_ns, "camera", found, ("tree", "bird"), np.array([0.9, 0.8]))


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
    corners = project(TAG + np.array([0.0, 0.0, 2.0]))
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
