"""Where a robot may be by what a person says."""

import numpy as np
import pytest

from slam.common.arrays import FloatArray
from slam.common.errors import InputDataError
from slam.place_recognition.initial_pose import InitialPose
from tests.helpers.poses import pose_at


@pytest.mark.parametrize(
    ("x_m", "travel_m", "yaw_deg", "turned_deg", "is_allowed"),
    [
        (100.0, 0.0, 90.0, 0.0, True),
        (134.0, 0.0, 90.0, 0.0, True),
        (136.0, 0.0, 90.0, 0.0, False),  # beyond 3.5 sigmas
        (136.0, 20.0, 90.0, 0.0, True),  # ... unless the robot went there
        (100.0, 0.0, 180.0, 0.0, False),
        (100.0, 0.0, 180.0, 90.0, True),  # ... unless it turned
        (100.0, 0.0, -170.0, 90.0, True),
    ],
)
def test_places_and_headings(x_m: float, travel_m: float, yaw_deg: float, turned_deg: float, is_allowed: bool) -> None:
    prior = InitialPose(np.array([100.0, 50.0]), 10.0, yaw_rad=np.pi / 2)
    T_map_query = pose_at(x_m, 50.0, yaw=np.deg2rad(yaw_deg))
    T_first_query = pose_at(yaw=np.deg2rad(turned_deg))
    assert prior.allows(T_map_query, T_first_query, travel_m) is is_allowed


@pytest.mark.parametrize(
    ("position", "sigma_m"), [(np.zeros(3), 1.0), (np.array([np.nan, 0.0]), 1.0), (np.zeros(2), 0.0)]
)
def test_what_is_no_place_is_refused(position: FloatArray, sigma_m: float) -> None:
    with pytest.raises(InputDataError, match="give x and y in metres"):
        InitialPose(position, sigma_m)


def test_without_a_heading_any_is_allowed() -> None:
    prior = InitialPose(np.zeros(2), 1.0)
    assert prior.allows(pose_at(yaw=3.0), np.eye(4), 0.0)
