from dataclasses import replace
from typing import Any

import numpy as np
import pandas as pd
import pytest

from logs.messages import DetectionAssociations, DetectionTruth, ObjectMapRecord
from slam.common.errors import EvaluationError
from slam.evaluation.inputs.records import EvaluationRecords
from slam.evaluation.inputs.synchronization import PoseSeries
from slam.evaluation.metrics.association import evaluate_associations, identify_landmarks, label_detections
from tests.slam.evaluation.drives import straight_path
from tests.slam.evaluation.maps import frames, object_map

WALK = PoseSeries(np.arange(1001) * 1_000_000_000, straight_path(1001))  # 1 m/s from time 0


def labelled(
    associations: list[DetectionAssociations], truths: list[DetectionTruth], objects: ObjectMapRecord | None = None
) -> pd.DataFrame:
    return label_detections(
        EvaluationRecords(
            associations=tuple(associations), detection_truths=tuple(truths), odometry_path=WALK, object_map=objects
        )
    )


def quality(*detections: list[tuple[str, str, bool]], objects: ObjectMapRecord | None = None) -> dict[str, Any]:
    return evaluate_associations(labelled(*frames(*detections), objects))


def test_figures_by_hand() -> None:
    result = quality(
        [("a", "1", True), ("b", "2", True)],
        [("a", "1", False), ("b", "1", False)],  # b is given to a's landmark
        [("a", "1", False), ("b", "2", False), ("", "2", False)],  # a false positive is given to b's
        [("a", "", False), ("b", "3", True), ("", "4", True)],  # a is missed, b gets a second landmark
    )
    assert (result["detection_count"], result["assigned_count"], result["right_count"]) == (10, 5, 3)
    assert result["precision"] == 3 / 5
    assert (result["possible_count"], result["made_count"]) == (6, 3)
    assert result["recall"] == 1 / 2


@pytest.mark.parametrize(("distance_m", "possible"), [(100, 1), (101, 0)])
def test_association_is_possible_within_revisit_distance(distance_m: int, possible: int) -> None:
    associations, truths = frames([("a", "1", True)], [("a", "1", False)], stamps_ns=[0, distance_m * 1_000_000_000])
    result = evaluate_associations(labelled(associations, truths), revisit_m=100.0)
    assert (result["possible_count"], result["made_count"]) == (possible, possible)
    assert result["recall"] == (1.0 if possible else None)


def test_merged_landmarks_count_for_the_one_they_became() -> None:
    # Landmark 3 is a's by most of its detections, and so is 1 once 3 is merged into it.
    detections = ([("a", "3", True)], [("a", "3", False)], [("a", "3", False)], [("b", "1", True)], [("b", "1", False)])
    objects = replace(object_map(("1", "2", "3"), np.zeros((3, 3)), ("x",) * 3), merged_into=("", "1", "1"))
    assert [quality(*detections, objects=known)["right_count"] for known in (None, objects)] == [3, 2]


@pytest.mark.parametrize(("detections", "reason"), [((), "no associations"), (([], []), "none of 2 frames")])
def test_no_detections(detections: tuple[list[tuple[str, str, bool]], ...], reason: str) -> None:
    with pytest.raises(EvaluationError, match=reason):
        quality(*detections)


def test_frames_without_counterpart_are_left_out() -> None:
    associations, truths = frames([("a", "1", True)], [("a", "1", False)], [("a", "1", False)])
    table = labelled(associations[:2], [*truths[1:], DetectionTruth(77, ("a",))])
    assert len(table) == 1
    assert evaluate_associations(table)["possible_count"] == 0


def test_a_truth_of_another_log_is_refused_with_its_time() -> None:
    associations, _ = frames([("a", "1", True)], stamps_ns=[123])
    with pytest.raises(EvaluationError, match="123 ns"):
        labelled(associations, [DetectionTruth(123, ("a", "b"))])


def test_tie_goes_to_the_object_that_the_landmark_met_first() -> None:
    associations, truths = frames([("b", "1", True)], [("a", "1", False)], [("", "1", False)])
    table = labelled(associations, truths)
    assert identify_landmarks(table) == {"1": "b"}
