"""Robots that are lost, by hand."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from logs.messages import LoopClosureRecord, StatusRecord
from slam.common.arrays import FloatArray
from slam.evaluation.inputs.protocol import Protocol
from slam.evaluation.inputs.records import EvaluationRecords
from slam.evaluation.inputs.synchronization import NO_POSES, PoseSeries
from slam.evaluation.metrics.relocalization import MEASURES, evaluate_relocalization
from tests.helpers.poses import pose_at
from tests.slam.evaluation.loops import at_ns, closure, there_and_back

TRUTH = there_and_back()


def statuses(*events: tuple[int, str]) -> tuple[StatusRecord, ...]:
    """By the index of a pose of the drive, a second and a metre each."""
    return tuple(StatusRecord(at_ns(index), state, "info", "") for index, state in events)


def made(*events: tuple[int, str], closures: tuple[LoopClosureRecord, ...] = ()) -> EvaluationRecords:
    """Poses that are right, and a last status at the end of the drive."""
    at_end = (240, events[-1][1])
    return EvaluationRecords(
        statuses=statuses(*events, at_end),
        online_path=TRUTH,
        true_path=TRUTH,
        closures=closures,
        provenance={} if closures else {"map_drives": "1"},
    )


def measure(records: EvaluationRecords, T_world_map: FloatArray | None = None) -> dict[str, Any]:
    T_world_map = np.eye(4) if T_world_map is None else T_world_map
    return evaluate_relocalization(records, Protocol(), None, T_world_map)


def test_losses_by_hand() -> None:
    found = measure(
        made(
            (0, "LOST"),
            (10, "RELOCALIZED"),
            (10, "TRACKING"),
            (100, "LOST"),
            (110, "LOST"),
            (140, "RELOCALIZED"),
            (140, "TRACKING"),
            (200, "LOST"),
        )
    )
    assert [(loss["seconds"], loss["distance_m"]) for loss in found["losses"]] == [
        (pytest.approx(10.0), pytest.approx(10.0)),
        (pytest.approx(40.0), pytest.approx(40.0)),
        (None, None),
    ]
    assert (found["loss_count"], found["fix_count"], found["right_count"], found["wrong_count"]) == (3, 2, 2, 0)
    assert (found["success_rate"], found["false_relocalization_rate"]) == (pytest.approx(2 / 3), 0.0)
    assert (found["median_seconds"], found["median_distance_m"]) == pytest.approx((25.0, 25.0))
    assert found["median_error_m"] == pytest.approx(0.0, abs=1e-9)


def test_drives_without_loss_or_fix() -> None:
    found = measure(made((0, "MAPPING")))
    assert found["loss_count"] == 0
    assert found["success_rate"] is found["false_relocalization_rate"] is None
    assert {found[f"median_{name}"] for name in MEASURES} == {None}
    lost = measure(made((0, "LOST")))
    assert (lost["loss_count"], lost["fix_count"], lost["success_rate"]) == (1, 0, 0.0)


@pytest.mark.parametrize(("shift_m", "is_right"), [(3.9, True), (4.1, False)])
def test_a_fix_is_right_within_the_thresholds_of_closures(shift_m: float, is_right: bool) -> None:
    off = pose_at(0.0, shift_m)
    found = measure(made((0, "LOST"), (0, "RELOCALIZED"), (0, "TRACKING")), off)
    assert found["losses"][0]["is_right"] is is_right
    assert (found["right_count"], found["wrong_count"]) == (int(is_right), int(not is_right))
    assert found["false_relocalization_rate"] == float(not is_right)


def test_the_pose_right_after_the_fix_counts() -> None:
    records = made((0, "LOST"), (50, "RELOCALIZED"), (50, "TRACKING"))
    at = np.arange(len(TRUTH))
    poses = np.where((at == 50)[:, None, None], TRUTH.T_world_body, pose_at(9.0) @ TRUTH.T_world_body)
    assert measure(replace(records, online_path=PoseSeries(TRUTH.stamps_ns, poses)))["success_rate"] == 1.0
    late = PoseSeries(TRUTH.stamps_ns[at != 50], poses[at != 50])
    assert measure(replace(records, online_path=late))["success_rate"] == 0.0


def test_fix_in_own_map_is_judged_by_closure() -> None:
    closures = (
        closure(100, 90, truth=TRUTH, shift_m=30.0),  # before
        closure(204, 203, truth=TRUTH, shift_m=30.0),  # not across the break
        closure(204, 36, truth=TRUTH, shift_m=30.0, stage="acceptance"),
        closure(202, 38, truth=TRUTH, shift_m=30.0),  # came too early to be the one
        closure(204, 36, truth=TRUTH, shift_m=3.9),
        closure(206, 34, truth=TRUTH, shift_m=30.0),
    )
    records = made((0, "MAPPING"), (201, "LOST"), (204, "RELOCALIZED"), (204, "MAPPING"), closures=closures)
    found = measure(records)
    assert found["losses"][0]["error_m"] == pytest.approx(3.9)


def test_without_truth_fixes_are_undecided_and_still_timed() -> None:
    events = ((0, "LOST"), (10, "RELOCALIZED"), (10, "TRACKING"), (50, "LOST"))
    found = measure(replace(made(*events), true_path=NO_POSES))
    assert (found["fix_count"], found["undecided_count"], found["right_count"], found["wrong_count"]) == (1, 1, 0, 0)
    # The loss that ended in no fix is no success, whatever the truth would say.
    assert (found["success_rate"], found["false_relocalization_rate"]) == (0.0, 0.0)
    assert found["median_seconds"] == pytest.approx(10.0)
    assert found["median_distance_m"] is None
    assert measure(replace(made(*events[:3]), true_path=NO_POSES))["success_rate"] is None
    along = measure(replace(made(*events), true_path=NO_POSES, odometry_path=TRUTH))
    assert along["median_distance_m"] == pytest.approx(10.0)
