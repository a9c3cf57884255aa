import numpy as np
import pytest

from logs.errors import DatasetError
from logs.importers.text_files import SourceText
from logs.importers.trajectory_files import read_trajectory

TUM = "0.1 1 2 3 0 0 0.6 0.8\n0.2 1 2 4 0 0 0 1\n"
HALF_TURN = np.array([[0.28, -0.96, 0.0], [0.96, 0.28, 0.0], [0.0, 0.0, 1.0]])
"""Rotation of the quaternion (0, 0, 0.6, 0.8)."""


def source(text: str, name: str = "poses.txt") -> SourceText:
    return SourceText(name, text, "")


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        (f"# a comment, with a comma\n\n{TUM}", "tum"),
        (TUM.replace(" ", ", "), "tum"),
        (f"timestamp tx ty tz qx qy qz qw\n{TUM}", "csv"),
        ("qw;qz;qy;qx;z [mm];y [mm];x [mm];t [ms]\n.8;.6;0;0;3000;2000;1000;100\n1;0;0;0;4000;2000;1000;200\n", "csv"),
    ],
)
def test_formats_give_same_poses(text: str, expected: str) -> None:
    trajectory = read_trajectory(source(text))
    assert trajectory.format == expected
    np.testing.assert_array_equal(trajectory.stamps_ns, [100_000_000, 200_000_000])
    np.testing.assert_allclose(trajectory.T_world_body[:, :3, 3], [[1, 2, 3], [1, 2, 4]])
    np.testing.assert_allclose(trajectory.T_world_body[0, :3, :3], HALF_TURN, atol=1e-12)
    np.testing.assert_allclose(trajectory.T_world_body[1, :3, :3], np.eye(3), atol=1e-12)
    assert trajectory.length_m == pytest.approx(1.0)


@pytest.mark.parametrize(("name", "scale"), [("yaw", 1.0), ("yaw_rad", 1.0), ("yaw_deg", 180.0 / np.pi)])
def test_heading_by_unit_of_column(name: str, scale: float) -> None:
    angles = np.array([3.1, -3.1, 0.2])
    rows = "".join(f"{i},{i},0,{angle * scale!r}\n" for i, angle in enumerate(angles.tolist()))
    R = read_trajectory(source(f"t,x,y,{name}\n{rows}")).T_world_body[:, :3, :3]
    np.testing.assert_allclose(np.arctan2(R[:, 1, 0], R[:, 0, 0]), angles, atol=1e-12)


def test_kitti_poses_with_times_and_calibration() -> None:
    # The camera moves along its z, which is forward: x of the body.
    poses = source("".join(f"1 0 0 0 0 1 0 0 0 0 1 {z}\n" for z in range(3)))
    times_ns = np.array([0, 103_735_900, 200_000_000])
    calib = source("Tr: 0 -1 0 0.1 0 0 -1 0.2 1 0 0 -0.3\n", "calib.txt")
    trajectory = read_trajectory(poses, times_ns=times_ns, calib=calib)
    np.testing.assert_array_equal(trajectory.stamps_ns, times_ns)
    np.testing.assert_allclose(trajectory.T_world_body[:, :3, 3], [[0, 0, 0], [1, 0, 0], [2, 0, 0]], atol=1e-12)
    np.testing.assert_allclose(read_trajectory(poses, times_ns=times_ns).T_world_body[2, :3, 3], [0, 0, 2], atol=1e-12)
    with pytest.raises(DatasetError, match=r"poses\.txt has 3 poses without stamps, and there are 2 times"):
        read_trajectory(poses, times_ns=times_ns[:2])


def test_stamps_keep_every_digit() -> None:
    trajectory = read_trajectory(source("1700000000.123456789 0 0 0 0 0 0 1\n1700000000.2 0 0 1 0 0 0 1\n"))
    assert trajectory.stamps_ns[0] == 1_700_000_000_123_456_789


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", r"poses\.txt is empty"),
        ("1 2 3\n", r"poses\.txt: 3 values .*expected 8 .TUM.*names the columns"),
        (TUM + "0.3 1 -1e308 3 0 0 0 1\n", r"poses\.txt, line 3, column y: -1e308 m is too far away; correct it"),
        (TUM + "0.3 1 2 3 0 0 0 0.5\n", r"poses\.txt, line 3, column qw: the norm of the quaternion is not 1"),
        (TUM + "0.2 1 2 3 0 0 0 1\n", r"poses\.txt, line 3, column stamp_s: 0\.2 occurs twice; remove"),
        ("0.1 0 0 0 0 0 0 1\n", r"poses\.txt: one pose only"),
        ("stamp_s,x_m,z_m,yaw\n0,1,2,3\n", r"poses\.txt: no column for y in metres among .*; name .* y_m"),
        ("stamp_s,x_m,y_m\n0,1,2\n", r"poses\.txt: no rotation among stamp_s, x_m, y_m; give yaw"),
        ("t,x,y,yaw\n0,1,2,359\n1,1,2,1\n", r"line 3, column yaw: 1 differs .* by more than a turn; .*yaw_deg"),
        ("0e9 0 0 0 0 0 0 1\n1e8 1 0 0 0 0 0 1\n", r"poses are 1e\+08 s apart .*by its unit"),
        ("0.0 0 0 0 0 0 0 1\n0.1 0 0 0 0 0 0 1\n0.2 100 0 0 0 0 0 1\n", r"moves at 1000 m/s .*divide them by 1000"),
        ("1 0 0 0 0 1 0 0 0 0 1 0\n", r"poses\.txt: poses in KITTI's format have no stamps; .*--times"),
    ],
)
def test_read_trajectory_refuses(text: str, message: str) -> None:
    with pytest.raises(DatasetError, match=message) as caught:
        read_trajectory(source(text))
    assert "\n" not in str(caught.value)
