import tracemalloc

import numpy as np

from slam.odometry.pose import OdometryPose
from slam.odometry.track import OdometryPath
from tests.helpers.poses import pose_at


def pose(number: int, segment: int = 0) -> OdometryPose:
    T_odom_body = pose_at(0.1 * number, 1.0, z=-2.0, yaw=0.01 * number)
    return OdometryPose(10**18 + number, T_odom_body, 0.1 * number, segment, 1.0)


def test_poses_come_back_as_they_were():
    path = OdometryPath()
    assert (path.first_stamp_ns, path.latest, path.T_odom_body.shape) == (0, None, (0, 4, 4))
    poses = [pose(number, segment=number // 3) for number in range(5)]
    for each in poses:
        path.add(each)
    assert (path.first_stamp_ns, path.latest) == (poses[0].stamp_ns, poses[-1])
    np.testing.assert_array_equal(path.stamps_ns, [each.stamp_ns for each in poses])
    np.testing.assert_array_equal(path.segments, [0, 0, 0, 1, 1])
    np.testing.assert_array_equal(path.T_odom_body, [each.T_odom_body for each in poses])


def test_a_segment_begins_at_a_past_pose():
    path = OdometryPath()
    for number in range(5):
        path.add(pose(number))
    path.break_at(pose(3).stamp_ns)
    assert path.latest.segment == 1
    np.testing.assert_array_equal(path.segments, [0, 0, 0, 1, 1])


def test_a_pose_takes_little_memory():
    path, count = OdometryPath(), 5_000
    tracemalloc.start()
    for number in range(count):
        path.add(pose(number))
    held, _ = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    assert held / count < 150.0
