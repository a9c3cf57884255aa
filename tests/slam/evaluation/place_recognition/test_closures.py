"""Precision and recall of loop closures, on a drive of 120 m and back."""

from collections.abc import Mapping
from dataclasses import replace

import numpy as np
import pytest

from logs.closures import Stage, find_final_decisions
from logs.messages import LoopClosureRecord
from slam.evaluation.evaluate import evaluate
from slam.evaluation.inputs.synchronization import PoseSeries, clean_poses
from slam.evaluation.place_recognition.revisits import NO_TRUE_CANDIDATE
from tests.helpers.poses import motion_by
from tests.slam.evaluation.drives import straight_path
from tests.slam.evaluation.loops import (
    THERE_AND_BACK_REVISITS,
    closure,
    drive_with,
    judge,
    keyframes,
    series_of,
    there_and_back,
)

TRUTH = there_and_back()
STRAIGHT = series_of(straight_path(300))
REVISITS = THERE_AND_BACK_REVISITS
COUNT = len(REVISITS)
KEPT = np.r_[0:30, 40:200]


def loop(query: int, reference: int | None = None, **more: float | str) -> LoopClosureRecord:
    """A candidate with its transform, at the same place unless told otherwise."""
    return closure(query, 240 - query if reference is None else reference, truth=TRUTH, **more)


def rolled(record: LoopClosureRecord) -> LoopClosureRecord:
    return replace(record, T_reference_query=record.T_reference_query @ motion_by([0.26, 0.0, 0.0]))


@pytest.mark.parametrize(
    ("records", "truth", "expected"),
    [
        pytest.param(
            [loop(query) for query in REVISITS],
            TRUTH,
            {
                **dict.fromkeys(("candidate_count", "accepted_count", "inserted_count", "true_count"), COUNT),
                **dict.fromkeys(("false_count", "undecided_count", "p95_translation_error_m"), 0.0),
                **dict.fromkeys(("precision", "recall", "recall_opposite"), 1.0),
                **dict.fromkeys(("recall_same", "recall_crossing")),
                "missed_by_stage": {},
            },
            id="all true",
        ),
        pytest.param(
            [loop(200), loop(30, 10, shift_m=9.0)],
            TRUTH,
            {"precision": 0.5, "recall": 1 / COUNT},
            id="outside revisits only precision counts",
        ),
        pytest.param(
            [
                *(loop(query, stage="consistency") for query in (190, 200, 210)),
                *(loop(210), loop(200), loop(210, stage="acceptance")),
            ],
            TRUTH,
            {
                "candidate_count": 3,
                "accepted_count": 1,
                "recall": 1 / COUNT,
                "stage_counts": {"acceptance": 1, "consistency": 1, "accepted": 1},
                "missed_by_stage": {NO_TRUE_CANDIDATE: COUNT - 3, "acceptance": 1, "consistency": 1},
            },
            id="the last decision counts",
        ),
        pytest.param(
            [
                # The farthest true one counts, whatever farther stages a false one reached.
                *(loop(170, stage="acceptance"), loop(170, 68, stage="consistency"), loop(170, 6, shift_m=50.0)),
                loop(180, stage="acceptance"),
                closure(190, 50, stage="registration"),  # the right place, but no transform
                closure(200, 90, stage="retrieval"),
                *(loop(210, stage="acceptance"), loop(210, 32)),
                loop(220, stage="a stage of later days"),
            ],
            TRUTH,
            {
                "recall": 1 / COUNT,
                "recall_opposite": 1 / COUNT,
                "missed_by_stage": {
                    NO_TRUE_CANDIDATE: COUNT - 4,
                    "a stage of later days": 1,
                    "acceptance": 1,
                    "consistency": 1,
                },
            },
            id="missed by the farthest stage",
        ),
        pytest.param(
            [
                *(loop(190), loop(230)),  # the second after the truth
                loop(195, 35),  # the reference in its gap
                replace(closure(180, 60), accepted=True),  # without a transform
            ],
            clean_poses(TRUTH.stamps_ns[KEPT], TRUTH.T_world_body[KEPT]),
            {"accepted_count": 4, "true_count": 1, "false_count": 0, "undecided_count": 3, "precision": 1.0},
            id="without truth undecided",
        ),
        pytest.param(
            [closure(20, 4, truth=STRAIGHT)],
            STRAIGHT,
            {"precision": 1.0, "revisit_count": 0, "recall": None},
            id="no revisits",
        ),
        pytest.param(
            [
                *(loop(170, shift_m=1.0), loop(172, shift_m=1.0), loop(174, shift_m=1.0)),
                *(loop(200, shift_m=2.0), loop(202, shift_m=2.6), loop(230, shift_m=3.5)),
                *(loop(204, turn_rad=1.0), loop(206, shift_m=3.0, stage="acceptance")),  # neither is a true closure
            ],
            TRUTH,
            {
                "median_translation_error_m": 1.5,
                "p95_translation_error_m": float(np.percentile([1, 1, 1, 2, 2.6, 3.5], 95)),
                "median_rotation_error_deg": 0.0,
            },
            id="errors of true closures",
        ),
        pytest.param([rolled(loop(200))], TRUTH, {"false_count": 1}, id="a roll is an error"),
    ],
)
def test_figures(records: list[LoopClosureRecord], truth: PoseSeries, expected: Mapping[str, object]) -> None:
    found = judge(records, truth, range(0, 300, 2) if truth is STRAIGHT else range(0, 241, 2))
    for key, value in expected.items():
        assert found[key] == (pytest.approx(value, abs=1e-6) if isinstance(value, float) else value), key


@pytest.mark.parametrize(
    ("shift_m", "turn_deg", "is_true"),
    [(4.0 + 1e-6, 0.0, False), (-4.0, 9.9999, True), (0.0, -9.9999, True), (0.0, 10.0001, False)],
)
def test_closure_thresholds_are_inclusive(shift_m: float, turn_deg: float, is_true: bool) -> None:
    record = closure(20, 4, truth=STRAIGHT, shift_m=shift_m, turn_rad=float(np.deg2rad(turn_deg)))
    found = judge([record], STRAIGHT, range(30))
    assert (found["true_count"], found["false_count"]) == (int(is_true), int(not is_true))


def test_decisions_and_stages_are_in_order() -> None:
    records = [closure(9, 3), closure(5, 2), closure(9, 1), closure(5, 2, stage="retrieval")]
    final = [(r.query_keyframe_id, r.reference_keyframe_id, r.stage) for r in find_final_decisions(records)]
    assert final == [(5, 2, "retrieval"), (9, 1, "accepted"), (9, 3, "accepted")]
    found = judge([closure(200 + k, k, stage=stage) for k, stage in enumerate(reversed(Stage))], TRUTH)
    assert list(found["stage_counts"]) == list(Stage)


def test_two_keyframes_with_one_stamp() -> None:
    ids, stamps_ns = keyframes([40, 200, 200])
    ids[2] = 999
    found = drive_with([replace(loop(200), query_keyframe_id=999)], TRUTH, ids, stamps_ns)
    figures = evaluate(found).to_json_dict()["closures"]
    assert (figures["precision"], figures["recall"], figures["revisit_count"]) == (1.0, 0.0, 1)
