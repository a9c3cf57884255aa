from dataclasses import replace
from typing import Any

import numpy as np
import pandas as pd
import pytest

from logs.messages import ObjectMapRecord
from slam.common.arrays import FloatArray
from slam.common.errors import EvaluationError
from slam.common.geometry import apply
from slam.evaluation.inputs.protocol import Protocol
from slam.evaluation.inputs.records import EvaluationRecords
from slam.evaluation.inputs.synchronization import PoseSeries
from slam.evaluation.metrics.landmarks import compute_windowed_errors_m, evaluate_landmarks, match_by_detections
from tests.helpers.poses import pose_at
from tests.slam.evaluation.drives import straight_path
from tests.slam.evaluation.maps import object_map

WALK = PoseSeries(np.arange(201) * 1_000_000_000, straight_path(201))


def street(rng: np.random.Generator) -> tuple[FloatArray, FloatArray]:
    """Positions (N, 3) beside a street of 200 m, and how far along each was first seen."""
    count = 400
    along = np.sort(rng.uniform(0.0, 200.0, count))
    return np.stack([along, rng.uniform(-10, 10, count), rng.uniform(0, 3, count)], axis=1), along


def windowed_errors_m(
    positions_est: FloatArray, positions_gt: FloatArray, seen_at_m: FloatArray, path_length_m: float
) -> FloatArray:
    return compute_windowed_errors_m(positions_est, positions_gt, seen_at_m, path_length_m, window_m=50.0)


def quality(
    map_est: ObjectMapRecord,
    map_gt: ObjectMapRecord,
    shows: dict[str, str],
    *,
    counts: dict[str, int] | None = None,
    T_world_map: FloatArray | None = None,
) -> dict[str, Any]:
    records = EvaluationRecords(object_map=map_est, true_objects=map_gt, true_path=WALK)
    others = [("", name) for name, count in (counts or {}).items() for _ in range(count - 1)]
    labelled = pd.DataFrame([*shows.items(), *others], columns=["landmark", "object"])
    matches = match_by_detections(records, labelled)
    return evaluate_landmarks(records, Protocol(), labelled, matches, T_world_map)


def test_windowed_errors_ignore_drift_and_measure_noise() -> None:
    rng = np.random.default_rng(0)
    positions, along = street(rng)
    bent = apply(pose_at(30.0, -4.0, z=2.0, yaw=1.0), positions)
    np.testing.assert_allclose(windowed_errors_m(bent, positions, along, 200.0), 0.0, atol=1e-9)

    drifting = positions.copy()
    drifting[along >= 100.0] += [7.0, 0.0, 0.0]  # only the window across the jump can see it
    jumped_m = windowed_errors_m(drifting, positions, along, 200.0)
    assert np.count_nonzero(jumped_m > 1e-6) <= np.count_nonzero((along >= 75.0) & (along < 125.0))
    assert np.median(jumped_m) < 1e-9

    noisy = positions + rng.normal(0.0, 0.3, positions.shape)
    assert np.sqrt(np.mean(windowed_errors_m(noisy, positions, along, 200.0) ** 2 / 3.0)) == pytest.approx(0.3, rel=0.1)


def test_path_with_jump_takes_no_longer() -> None:
    positions, along = street(np.random.default_rng(0))
    far = np.where(along > 100.0, along + 1e15, along)
    assert set(np.round(windowed_errors_m(positions, positions, far, 1e15 + 200.0), 6)) == {0.0}


def test_windows_cover_the_path_and_overlap_by_half() -> None:
    seen = np.array([10.0, 30.0, 60.0, 99.9])
    points = np.repeat(np.array([[0.0, 0, 0], [1.0, 0, 0], [0, 1.0, 0]]), 4, axis=0)
    # [0, 50) and [25, 75) hold two stations each, [50, 100) two, [75, 125) one, of three landmarks.
    assert len(windowed_errors_m(points, points, np.tile(seen, 3), 100.0)) == 6 + 6 + 6 + 3


@pytest.mark.parametrize("points", [np.zeros((0, 3)), np.eye(2, 3), np.zeros((5, 3))])
def test_windows_with_few_landmarks_or_one_place_are_left_out(points: FloatArray) -> None:
    assert len(windowed_errors_m(points, points, np.zeros(len(points)), 100.0)) == 0


def test_quality_by_hand() -> None:
    rng = np.random.default_rng(1)
    true_ids = tuple(f"o{i}" for i in range(6))
    positions = rng.uniform(-20, 20, (6, 3))
    map_gt = object_map(true_ids, positions, ("tree", "tree", "pole", "pole", "sign", "sign"))
    T_map_world = pose_at(1.0, 2.0, z=3.0, yaw=0.5)
    # 0..3 show o0..o3 (3 with the wrong class), 4 is a false positive, 5 shows what the true map lacks, 6 is tentative.
    at = np.concatenate([apply(T_map_world, positions[:4]), np.zeros((3, 3))])
    map_est = object_map(
        tuple("0123456"),
        at,
        ("tree", "tree", "pole", "tree", "tree", "car", "sign"),
        states=("confirmed",) * 6 + ("tentative",),
    )
    shows = {"0": "o0", "1": "o1", "2": "o2", "3": "o3", "4": "", "5": "moving", "6": "o4"}
    counts = {"o0": 9, "o1": 5, "o2": 4, "o4": 7, "moving": 30}
    result = quality(map_est, map_gt, shows, counts=counts, T_world_map=np.linalg.inv(T_map_world))
    assert (result["confirmed_count"], result["matched_count"], result["landmarks_per_object"]) == (6, 4, 1.0)
    assert result["precision"] == 5 / 6
    assert result["recall"] == 2 / 3
    assert result["class_accuracy"] == 3 / 4
    assert result["max_error_m"] < 1e-9
    assert result["global_median_error_m"] < 1e-9


def test_unseen_landmarks_of_prior_map_are_left_out() -> None:
    names = ("a", "b", "c")
    map_gt = object_map(names, np.eye(3), ("tree",) * 3)
    records = EvaluationRecords(object_map=map_gt, true_objects=map_gt)
    labelled = pd.DataFrame({"landmark": ["a", "b"], "object": ["a", ""]})
    own = match_by_detections(records, labelled)
    assert own["is_object"].tolist() == [True, False, False]
    localized = match_by_detections(replace(records, provenance={"map_drives": "1"}), labelled)
    assert localized["landmark"].tolist() == [0, 1]
    assert localized["is_object"].tolist() == [True, False]


def test_empty_map() -> None:
    empty = object_map((), np.zeros((0, 3)), ())
    map_gt = object_map(("a",), np.zeros((1, 3)), ("tree",))
    for gt in (map_gt, empty):
        result = quality(empty, gt, {}, counts={"a": 9})
        assert (result["precision"], result["median_error_m"], result["class_accuracy"]) == (None, None, None)
        assert result["recall"] == (0.0 if gt is map_gt else None)


def test_landmarks_first_seen_without_truth_have_no_window() -> None:
    positions = np.array([[0.0, 0, 0], [5.0, 0, 0], [0, 5.0, 0]])
    map_gt = object_map(("a", "b", "c"), positions, ("x",) * 3)
    late = np.full(3, 999_000_000_000, int)
    map_est = object_map(("a", "b", "c"), positions, ("x",) * 3, first_seen_ns=late)
    assert quality(map_est, map_gt, {name: name for name in "abc"})["median_error_m"] is None


def test_a_position_that_is_not_finite_is_refused() -> None:
    map_gt = object_map(("a",), np.zeros((1, 3)), ("x",))
    map_est = object_map(("a",), np.full((1, 3), np.nan), ("x",))
    with pytest.raises(EvaluationError, match="finite"):
        quality(map_est, map_gt, {"a": "a"})
