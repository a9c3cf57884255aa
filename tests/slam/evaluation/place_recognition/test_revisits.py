import numpy as np
import pandas as pd
import pytest

from slam.common.arrays import IntArray
from slam.common.geometry import transform_from_xyz_yaw
from slam.evaluation.inputs.protocol import Protocol
from slam.evaluation.inputs.synchronization import PoseSeries, clean_poses
from slam.evaluation.place_recognition.revisits import find_revisits
from tests.slam.evaluation.drives import straight_path
from tests.slam.evaluation.loops import THERE_AND_BACK_REVISITS, at_ns, drive_with, keyframes, series_of, there_and_back


def find(truth: PoseSeries, indices: range | list[int]) -> pd.DataFrame:
    return find_among(truth, *keyframes(indices))


def find_among(truth: PoseSeries, ids: IntArray, stamps_ns: IntArray) -> pd.DataFrame:
    return find_revisits(drive_with([], truth, ids, stamps_ns), pd.DataFrame(), Protocol())


def is_revisit_of(queries: pd.DataFrame) -> pd.Series:
    return queries["direction"] != ""


def out_and_return(far_m: float, back: tuple[float, float, float], heading_deg: float = 180.0) -> PoseSeries:
    """From the origin straight to ``far_m``, then straight to ``back``."""
    xyz = np.array([(0.0, 0.0, 0.0), (far_m, 0.0, 0.0), back])
    return series_of(transform_from_xyz_yaw(xyz, np.deg2rad([0.0, 0.0, heading_deg])))


@pytest.mark.parametrize(
    ("heading_deg", "direction"),
    [(0, "same"), (-44.9, "same"), (45.1, "crossing"), (-134.9, "crossing"), (135.1, "opposite"), (180, "opposite")],
)
def test_directions(heading_deg: float, direction: str) -> None:
    found = find(out_and_return(150.0, (2.0, 0.0, 0.0), heading_deg), range(3))
    assert found["direction"].tolist() == ["", "", direction]


@pytest.mark.parametrize(
    ("far_m", "back", "is_revisit"),
    [
        (150.0, (5.0, 0.0, 0.0), True),
        (150.0, (5.01, 0.0, 0.0), False),
        (150.0, (3.0, 0.0, 4.01), False),  # on the bridge above
        (52.0, (4.0, 0.0, 0.0), True),  # 52 + 48 m
        (51.9, (4.0, 0.0, 0.0), False),
    ],
)
def test_borders_of_a_revisit(far_m: float, back: tuple[float, float, float], is_revisit: bool) -> None:
    assert is_revisit_of(find(out_and_return(far_m, back), range(3))).tolist() == [False, False, is_revisit]


def test_queries_are_thinned_but_revisit_any_keyframe() -> None:
    found = find(there_and_back(), range(241))
    assert found["keyframe"].tolist() == list(range(0, 241, 2))
    # With the odd keyframes 235 - k is one to come back to, but no earlier query than with the even ones alone.
    assert found["keyframe"][is_revisit_of(found)].tolist() == list(THERE_AND_BACK_REVISITS)


@pytest.mark.parametrize(("spacing_m", "kept"), [(1.95, 21), (1.85, 11), (3.0, 21)])
def test_the_spacing_has_a_tolerance(spacing_m: float, kept: int) -> None:
    assert len(find(series_of(straight_path(21, spacing_m)), range(21))) == kept


def test_keyframes_without_truth_are_not_queries() -> None:
    whole = there_and_back()
    kept = np.r_[0:200, 210:231]
    truth = clean_poses(whole.stamps_ns[kept], whole.T_world_body[kept])
    found = find(truth, range(0, 241, 2))
    assert found["keyframe"].tolist() == [*range(0, 199, 2), *range(210, 231, 2)]


def test_duplicated_stamps_disorder_and_one_pose() -> None:
    ids, stamps_ns = np.array([7, 5, 3], int), np.array([at_ns(2), at_ns(2), at_ns(0)], int)
    found = find_among(there_and_back(), ids, stamps_ns)
    assert found["keyframe"].tolist() == [3, 5]
    one = series_of(np.eye(4)[None])
    assert find(one, range(5))["keyframe"].tolist() == [0]
    assert not is_revisit_of(find(one, range(5))).any()
