"""Submaps: which landmarks they hold, where, and how exactly."""

import numpy as np
import pytest

from slam.common.calibration import Calibration, ObjectCalibration
from slam.common.geometry import gravity_frame
from slam.object_map.landmarks import ObjectMap, RetirementReason
from slam.object_map.submap import make_submap, recent_submap, recent_submap_with_unconfirmed
from tests.helpers.poses import keyframe_at, motion_by, pose_at

CONFIG = Calibration(objects=ObjectCalibration(landmark_sigma_m=0.4, landmark_sigma_per_m=0.02))
HERE = keyframe_at(np.eye(4), travel_m=100.0)
OWN = np.diag([0.3**2, 0.5**2, 1.0])


def objects(*places: tuple[float, float, int, bool]) -> ObjectMap:
    """Landmarks at x, last seen at a travel, on a segment, confirmed or not."""
    found = ObjectMap(ObjectCalibration())
    for x_m, travel_m, segment, is_confirmed in places:
        labels = found.labels.indices(("tree",))
        rows = found.add(
            np.array([[x_m, 0.0, 1.0]]), OWN[None], labels, stamp_ns=1, scan=1, travel_m=travel_m, segment=segment
        )
        if is_confirmed:
            found.confirm(rows)
    return found


def test_a_recent_submap_holds_confirmed_landmarks_of_the_last_travel_on_its_segment():
    known = objects((1, 50.1, 0, True), (2, 49.9, 0, True), (3, 99, 0, False), (4, 99, 1, True), (5, 99, 0, True))
    found = recent_submap(known, HERE, CONFIG)
    assert found.rows.tolist() == [0, 4]


def test_it_is_upright_at_the_keyframe():
    lean = motion_by([0.0, -np.pi / 2, 0.0])
    T = pose_at(3.0, 4.0, yaw=np.pi / 2)
    found = recent_submap(objects((13.0, 99, 0, True)), keyframe_at(T, travel_m=100.0), CONFIG)
    np.testing.assert_allclose(found.positions, [[-4.0, -10.0, 1.0]], atol=1e-12)
    assert gravity_frame(T @ lean)[2, 2] == 1.0


@pytest.mark.parametrize("x_m", [0.0, 10.0, 40.0])
def test_a_landmark_is_the_less_exact_the_farther_away(x_m):
    own = (0.3**2 + 0.5**2) / 2.0
    expected = np.sqrt(0.4**2 + (0.02 * x_m) ** 2 + own)
    near = recent_submap(objects((x_m, 99, 0, True)), HERE, CONFIG)
    at, centre = np.array([[x_m + 5.0, 0.0, 1.0]]), np.array([5.0, 0.0, 0.0])
    placed = make_submap(objects((0.0, 99, 0, True)), np.array([0]), at, centre, CONFIG)
    np.testing.assert_allclose([near.sigmas[0], placed.sigmas[0]], expected)


def test_unconfirmed_landmarks_exist_with_the_share_of_those_seen_as_often_that_were_confirmed():
    known = objects(*((x, 99, 0, x < 3) for x in range(8)))
    known.assign(slice(None), observations=[9, 4, 3, 3, 2, 1, 3, 2])
    known.retire(np.array([4]), RetirementReason.NOT_CONFIRMED)
    known.retire(np.array([6]), RetirementReason.MOVING)
    found = recent_submap_with_unconfirmed(known, HERE, CONFIG)
    assert found.rows.tolist() == [0, 1, 2, 3, 4, 7]
    seen_3, seen_2 = (1.0 + 3.0) / (2.0 + 4.0), (1.0 + 3.0) / (2.0 + 5.0)
    np.testing.assert_allclose(found.existence, [1.0, 1.0, 1.0, seen_3, seen_2, seen_2])


def test_unconfirmed_landmarks_of_another_segment_say_nothing():
    known = objects((1, 99, 0, False), (2, 99, 1, True), (3, 99, 1, True))
    known.assign(slice(None), observations=[2, 5, 5])
    found = recent_submap_with_unconfirmed(known, HERE, CONFIG)
    assert found.rows.tolist() == [0]
    np.testing.assert_allclose(found.existence, 0.5)
