from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from logs.closures import STAGES, find_final_decisions
from slam.common.geometry import make_transform
from slam.evaluation.inputs.synchronization import clean_poses
from slam.evaluation.place_recognition.revisits import DIRECTIONS, NO_TRUE_CANDIDATE
from tests.slam.evaluation.drives import START_NS, straight_path
from tests.slam.evaluation.loops import (
    THERE_AND_BACK_REVISITS,
    at_ns,
    closure,
    evaluate_closures,
    judge,
    keyframes,
    series_of,
    there_and_back,
)

TRUTH = there_and_back()
REVISIT_COUNT = len(THERE_AND_BACK_REVISITS)


def test_all_true() -> None:
    records = [closure(query, 240 - query, truth=TRUTH) for query in THERE_AND_BACK_REVISITS]
    found = judge(records, TRUTH)
    assert (found["candidate_count"], found["accepted_count"], found["inserted_count"]) == (REVISIT_COUNT,) * 3
    assert (found["true_count"], found["false_count"], found["undecided_count"]) == (REVISIT_COUNT, 0, 0)
    assert found["precision"] == 1.0
    assert found["recall"] == 1.0
    assert [found[f"recall_{direction}"] for direction in DIRECTIONS] == [None, 1.0, None]
    assert found["missed_by_stage"] == {}
    assert found["p95_translation_error_m"] == pytest.approx(0.0, abs=1e-9)


def test_all_false() -> None:
    records = [closure(query, 240 - query, truth=TRUTH, shift_m=5.0) for query in THERE_AND_BACK_REVISITS]
    found = judge(records, TRUTH)
    assert (found["true_count"], found["false_count"], found["precision"]) == (0, REVISIT_COUNT, 0.0)
    assert found["median_translation_error_m"] is None
    assert found["recall"] == 0.0
    assert found["missed_by_stage"] == {NO_TRUE_CANDIDATE: REVISIT_COUNT}
    assert found["missed_at_place_count"] == REVISIT_COUNT
    assert found["missed_without_candidate_count"] == 0
    assert evaluate_closures(records, TRUTH, *keyframes(range(0, 241, 2))).missed_ns == tuple(
        at_ns(query) for query in THERE_AND_BACK_REVISITS
    )


def test_no_closures() -> None:
    found = judge([], TRUTH)
    assert (found["candidate_count"], found["true_count"], found["false_count"], found["precision"]) == (0, 0, 0, None)
    assert found["stage_counts"] == {}
    assert found["recall"] == 0.0
    assert found["missed_without_candidate_count"] == REVISIT_COUNT


@pytest.mark.parametrize(
    ("shift_m", "turn_deg", "is_true"),
    [
        (4.0, 0.0, True),
        (4.0 + 1e-6, 0.0, False),
        (-4.0, 9.9999, True),
        (0.0, -9.9999, True),
        (0.0, 10.0001, False),
        (0.0, 180.0, False),
    ],
)
def test_closure_thresholds_are_inclusive(shift_m: float, turn_deg: float, is_true: bool) -> None:
    straight = series_of(straight_path(30))
    record = closure(20, 4, truth=straight, shift_m=shift_m, turn_rad=float(np.deg2rad(turn_deg)))
    found = judge([record], straight, range(30))
    assert (found["true_count"], found["false_count"]) == (int(is_true), int(not is_true))


def test_closure_error_is_whole_rotation_angle() -> None:
    c, s = np.cos(np.deg2rad(15.0)), np.sin(np.deg2rad(15.0))
    roll = make_transform(np.array([[1.0, 0.0, 0.0], [0.0, c, -s], [0.0, s, c]]), np.zeros(3))
    record = closure(200, 40, truth=TRUTH)
    assert record.T_reference_query is not None
    assert judge([replace(record, T_reference_query=record.T_reference_query @ roll)], TRUTH)["false_count"] == 1


def test_closures_outside_revisits_count_only_for_precision() -> None:
    found = judge([closure(200, 40, truth=TRUTH), closure(30, 10, truth=TRUTH, shift_m=9.0)], TRUTH)
    assert found["precision"] == 0.5
    assert found["recall"] == 1 / REVISIT_COUNT


def test_last_decision_of_two_keyframes_counts() -> None:
    waiting = [closure(query, 240 - query, truth=TRUTH, stage="consistency") for query in (190, 200, 210)]
    revoked = closure(210, 30, truth=TRUTH)
    later = [closure(200, 40, truth=TRUTH), closure(210, 30, truth=TRUTH, stage="back_end")]
    found = judge([*waiting, revoked, *later], TRUTH)
    assert (found["candidate_count"], found["accepted_count"]) == (3, 1)
    assert found["stage_counts"] == {"consistency": 1, "back_end": 1, "accepted": 1}
    assert found["recall"] == 1 / REVISIT_COUNT
    assert found["missed_by_stage"] == {NO_TRUE_CANDIDATE: REVISIT_COUNT - 3, "consistency": 1, "back_end": 1}


def test_associated_revisit_is_recognised_without_closure() -> None:
    right = closure(200, 40, truth=TRUTH, stage="association")
    wrong = closure(210, 30, truth=TRUTH, stage="association", shift_m=9.0)
    revisits = judge([closure(190, 50, truth=TRUTH), right, wrong], TRUTH)
    assert revisits["missed_by_stage"]["association"] == 1
    assert revisits["recognised"] == 2 / REVISIT_COUNT


def test_final_decisions_are_in_order_of_time() -> None:
    records = [closure(9, 3), closure(5, 2), closure(9, 1), closure(5, 2, stage="retrieval")]
    found = find_final_decisions(records)
    assert [(r.query_keyframe_id, r.reference_keyframe_id, r.stage) for r in found] == [
        (5, 2, "retrieval"),
        (9, 1, "accepted"),
        (9, 3, "accepted"),
    ]


def test_missed_revisits_by_farthest_stage() -> None:
    records = [
        # The farthest true one counts, whatever farther stages a false one reached.
        closure(170, 70, truth=TRUTH, stage="acceptance"),
        closure(170, 68, truth=TRUTH, stage="consistency"),
        closure(170, 6, truth=TRUTH, stage="accepted", shift_m=50.0),
        closure(180, 60, truth=TRUTH, stage="acceptance"),
        closure(190, 50, stage="registration"),  # the right place, but no transform
        closure(200, 90, stage="retrieval"),
        closure(210, 30, truth=TRUTH, stage="acceptance"),
        closure(210, 32, truth=TRUTH),
        closure(220, 20, truth=TRUTH, stage="a stage of later days"),
    ]
    revisits = judge(records, TRUTH)
    assert revisits["recall_opposite"] == revisits["recall"] == 1 / REVISIT_COUNT
    assert revisits["missed_by_stage"] == {
        NO_TRUE_CANDIDATE: REVISIT_COUNT - 4,
        "a stage of later days": 1,
        "acceptance": 1,
        "consistency": 1,
    }
    assert revisits["missed_at_place_count"] == 1
    assert revisits["missed_without_candidate_count"] == REVISIT_COUNT - 6
    assert sum(revisits["missed_by_stage"].values()) == REVISIT_COUNT - 1


def test_stage_counts_are_in_order() -> None:
    found = judge([closure(200 + k, k, stage=stage) for k, stage in enumerate(reversed(STAGES))], TRUTH)
    assert list(found["stage_counts"]) == list(STAGES)


def test_closures_without_truth_are_undecided() -> None:
    kept = np.r_[0:30, 40:200]
    truth = clean_poses(TRUTH.stamps_ns[kept], TRUTH.T_world_body[kept])
    records = [
        closure(190, 50, truth=TRUTH),
        closure(230, 10, truth=TRUTH),  # after the truth
        closure(195, 35, truth=TRUTH),  # the reference in its gap
        closure(180, 60),  # without a transform
    ]
    records[-1] = replace(records[-1], accepted=True)
    found = judge(records, truth)
    assert (found["accepted_count"], found["true_count"], found["false_count"], found["undecided_count"]) == (
        4,
        1,
        0,
        3,
    )
    assert found["precision"] == 1.0


def test_no_truth() -> None:
    found = judge([closure(200, 40, truth=TRUTH)], series_of(np.zeros((0, 4, 4))))
    assert (found["candidate_count"], found["accepted_count"], found["inserted_count"]) == (1, 1, 1)
    assert (found["true_count"], found["false_count"], found["undecided_count"], found["precision"]) == (None,) * 4
    assert found["median_translation_error_m"] is None
    assert found["revisit_count"] is None


def test_no_revisits() -> None:
    straight = series_of(straight_path(300))
    found = judge([closure(20, 4, truth=straight)], straight, range(0, 300, 2))
    assert found["precision"] == 1.0
    assert (found["revisit_count"], found["recall"], found["average_precision"]) == (0, None, None)


def test_two_keyframes_with_one_stamp() -> None:
    ids, stamps_ns = keyframes([40, 200, 200])
    ids[2] = 999
    record = replace(closure(200, 40, truth=TRUTH), query_keyframe_id=999)
    found = evaluate_closures([record], TRUTH, ids, stamps_ns).to_json_dict()["closures"]
    assert found["precision"] == 1.0
    assert (found["recall"], found["revisit_count"]) == (0.0, 1)


def test_logs_without_the_stamp_of_the_reference() -> None:
    old = replace(closure(200, 40, truth=TRUTH), reference_stamp_ns=0)
    assert judge([old], TRUTH)["true_count"] == 1
    assert judge([old], TRUTH, [200])["undecided_count"] == 1


def test_errors_and_their_spread_within_a_revisit() -> None:
    # Two runs: both passes disagree by a constant, of which only what differs within a run is spread.
    shifts = {170: 1.0, 172: 1.0, 174: 1.0, 200: 2.0, 202: 2.6, 230: 3.5}
    records = [closure(query, 240 - query, truth=TRUTH, shift_m=shift) for query, shift in shifts.items()]
    records.append(closure(204, 36, truth=TRUTH, turn_rad=1.0))  # a false one
    records.append(closure(206, 34, truth=TRUTH, shift_m=3.0, stage="acceptance"))
    errors = judge(records, TRUTH)
    assert errors["median_translation_error_m"] == pytest.approx(1.5)
    assert errors["p95_translation_error_m"] == pytest.approx(np.percentile([1, 1, 1, 2, 2.6, 3.5], 95))
    assert errors["median_rotation_error_deg"] == pytest.approx(0.0, abs=1e-6)
    assert errors["intra_revisit_std_m"] == pytest.approx(0.5 * (0.0 + 0.3))
    single = judge([closure(200, 40, truth=TRUTH, turn_rad=np.deg2rad(3.0))], TRUTH)
    assert single["p95_rotation_error_deg"] == pytest.approx(3.0)
    assert single["median_heading_error_deg"] == pytest.approx(3.0)
    assert single["intra_revisit_std_m"] is None


def test_errors_in_the_plane_leave_out_height_and_tilt() -> None:
    record = closure(200, 40, truth=TRUTH)
    off = make_transform(Rotation.from_euler("ZYX", [0.02, 0.05, -0.03]).as_matrix(), np.array([0.3, -0.4, 2.0]))
    assert record.T_reference_query is not None
    errors = judge([replace(record, T_reference_query=record.T_reference_query @ off)], TRUTH)
    assert errors["median_planar_error_m"] == pytest.approx(0.5)
    assert errors["median_heading_error_deg"] == pytest.approx(np.rad2deg(0.02))
    assert errors["median_translation_error_m"] > 2.0


def test_sweep_includes_rejected_candidates() -> None:
    records = [
        closure(query, 240 - query, truth=TRUTH, stage="acceptance", score=float(query))
        for query in THERE_AND_BACK_REVISITS
    ]
    records.append(closure(240, 100, truth=TRUTH, shift_m=9.0, score=1.0))  # not the best of its query
    records.append(closure(100, 10, truth=TRUTH, shift_m=9.0, score=0.5))
    records.append(closure(102, 10, stage="registration", score=1e6))  # nothing to judge
    revisits = judge(records, TRUTH)
    assert revisits["average_precision"] == pytest.approx(1.0)
    assert revisits["recall_at_full_precision"] == 1.0
    assert revisits["precision_recall_curve"]["precision"][-1] == REVISIT_COUNT / (REVISIT_COUNT + 1)
    assert revisits["missed_by_stage"]["acceptance"] == REVISIT_COUNT


def test_a_drive_that_starts_at_zero() -> None:
    ids, stamps_ns = keyframes(range(0, 241, 2))
    record = replace(closure(240, 0, truth=TRUTH), stamp_ns=at_ns(240) - START_NS, reference_stamp_ns=0)
    truth = clean_poses(TRUTH.stamps_ns - START_NS, TRUTH.T_world_body)
    found = evaluate_closures([record], truth, ids, stamps_ns - START_NS).to_json_dict()["closures"]
    assert found["true_count"] == 1
    assert found["recall"] == 1 / REVISIT_COUNT
