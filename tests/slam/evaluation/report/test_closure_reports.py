"""Loop closures from a log to its JSON, report and picture."""

from __future__ import annotations

from dataclasses import replace

import pytest

from logs.messages import FactorGraphRecord, GroundTruthPose, LoopClosureRecord, Record, TrajectoryRecord
from slam.evaluation.evaluate import evaluate
from slam.evaluation.inputs.records import collect_records
from slam.evaluation.report.figures import summarize
from tests.slam.evaluation.loops import closure, there_and_back
from tests.slam.evaluation.results import at_json, graph


def there_and_back_log() -> list[tuple[str, Record]]:
    """120 m and back: 37 revisits, of which one closure is right, one waits and one keyframe closes a wrong one."""
    truth = there_and_back()
    closures = (
        closure(200, 40, truth=truth, shift_m=0.5),
        closure(210, 30, truth=truth, stage="consistency"),
        closure(60, 0, truth=truth, shift_m=9.0),
    )
    return [
        *(("/ground_truth", GroundTruthPose(t, T)) for t, T in zip(truth.stamps_ns, truth.T_world_body, strict=True)),
        ("/slam/trajectory_stamped", TrajectoryRecord(0, "map", truth.stamps_ns, truth.T_world_body)),
        ("/slam/graph", graph(truth.stamps_ns[::2], truth.T_world_body[::2])),
        *(
            ("/slam/closures", replace(c, query_keyframe_id=c.query_keyframe_id // 2, reference_keyframe_id=7 + k))
            for k, c in enumerate(closures)
        ),
    ]


def test_summary_tells_retrieved_from_propagated_closures() -> None:
    log = there_and_back_log()
    followed = [
        (topic, replace(record, seed_query_keyframe_id=90) if isinstance(record, LoopClosureRecord) else record)
        for topic, record in log
    ]
    told = summarize(evaluate(collect_records(log)).to_json_dict())["closures"]
    assert "50.00 % (1 true, 1 false)" in told
    assert "2.70 % of 37 revisits" in told
    assert told.endswith("; 2 retrieved, 0 propagated, 0 back; 2 independent: at most 97 % false")
    assert "; 0 retrieved, " in summarize(evaluate(collect_records(followed)).to_json_dict())["closures"]


@pytest.mark.parametrize(
    ("left_out", "reason"), [(GroundTruthPose, "ground truth"), (FactorGraphRecord, "/slam/graph")]
)
def test_missing_input_of_revisits_is_named(left_out: type, reason: str) -> None:
    result = evaluate(collect_records((t, r) for t, r in there_and_back_log() if not isinstance(r, left_out)))
    assert reason in result.unavailable["closures"]
    assert at_json(result, "closures.candidate_count") == 3
    assert "recall" not in result.to_json_dict()["closures"]
