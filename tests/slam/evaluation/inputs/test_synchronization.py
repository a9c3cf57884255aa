import numpy as np
import pytest

from slam.common.errors import EvaluationError
from slam.evaluation.inputs.synchronization import PoseSeries, clean_poses, synchronize
from tests.slam.evaluation.drives import START_NS, series, stamps, straight_path


def test_disorder_and_duplicates_are_repaired() -> None:
    T = straight_path(5)
    order = [0, 2, 1, 1, 4, 3]
    cleaned = clean_poses(stamps(5)[order], T[order])
    np.testing.assert_array_equal(cleaned.stamps_ns, stamps(5))
    np.testing.assert_array_equal(cleaned.T_world_body, T)


def test_synchronize_interpolates_at_epoch_scale() -> None:
    truth = series(straight_path(11, step_m=10.0), rate_hz=1.0)  # 10 m/s
    at_ns = START_NS + np.array([1, 250_000_001, 9_999_999_999], int)
    _, gt = synchronize(PoseSeries(at_ns, straight_path(3)), truth)
    np.testing.assert_allclose(gt.positions[:, 0], [1e-8, 2.50000001, 99.99999999], rtol=0, atol=1e-11)


def test_poses_beyond_the_truth_and_in_its_gaps_have_none() -> None:
    estimate = series(straight_path(101))  # 0 .. 10 s
    truth_at = np.array([1.0, 2.0, 3.0, 6.0, 7.0, 8.0])
    truth = clean_poses(START_NS + (truth_at * 1e9).astype(np.int64), straight_path(6))
    est, _ = synchronize(estimate, truth)
    seconds = (est.stamps_ns - START_NS) / 1e9
    assert not np.any((seconds > 3.0) & (seconds < 6.0))
    assert {3.0, 6.0} <= set(seconds.tolist())
    # 10 poses before and 20 after the truth, 29 from 3.1 to 5.9 s; 3.0 and 6.0 s have a truth of their own.
    assert len(seconds) == 101 - 30 - 29


def test_without_common_time_the_error_names_both_spans() -> None:
    early = series(straight_path(5))
    late = PoseSeries(early.stamps_ns + 10**12, early.T_world_body)
    with pytest.raises(EvaluationError, match=f"{late.stamps_ns[0]}.*{early.stamps_ns[0]}.*with the same clock"):
        synchronize(late, early)


@pytest.mark.parametrize("which", ["estimated", "true"])
def test_no_pose_at_all_is_an_error(which: str) -> None:
    none, some = series(np.zeros((0, 4, 4))), series(straight_path(3))
    pair = (none, some) if which == "estimated" else (some, none)
    with pytest.raises(EvaluationError, match=f"no {which} pose"):
        synchronize(*pair)


def test_clean_poses_refuses_non_finite_pose() -> None:
    T = straight_path(3)
    T[1, 0, 3] = np.nan
    with pytest.raises(EvaluationError, match=str(stamps(3)[1])):
        clean_poses(stamps(3), T)


def test_path_length_between_stamps_and_beyond_the_ends() -> None:
    path = series(straight_path(3, step_m=2.0), rate_hz=1.0)
    at = START_NS + np.array([-5, 500_000_000, 2_000_000_000, 9_000_000_000], int)
    np.testing.assert_allclose(path.travelled_at_m(at), [0.0, 1.0, 4.0, 4.0])
