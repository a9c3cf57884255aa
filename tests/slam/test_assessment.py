"""What a finished map cannot be trusted in."""

import re
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from logs.messages import FactorGraphRecord, ObjectMapRecord
from slam.assessment import assess, diagnose_uncorrected
from slam.backend.edge_kind import EdgeKind
from slam.common.calibration import Calibration
from slam.common.geometry import relative, transform_from_xyz_yaw
from slam.trajectory_check.judgement import TrajectoryCheck
from tests.helpers.graphs import with_edges
from tests.slam.evaluation.drives import straight_path

KEYFRAMES = 101
CALIBRATION = Calibration().with_values({"detection.sensor_range_m": 20.0})
UNDECIDED = TrajectoryCheck()


def drive(*, seen: range, landmarks: int = 2, step_m: float = 1.0) -> FactorGraphRecord:
    """A straight drive, in which each keyframe of ``seen`` observes so many landmarks."""
    ids = np.arange(10, 10 + KEYFRAMES)
    T = straight_path(KEYFRAMES, step_m)
    observers = np.repeat(ids[list(seen)], landmarks)
    count = len(observers)
    return FactorGraphRecord(
        stamp_ns=0,
        keyframe_ids=ids,
        keyframe_stamps_ns=ids,
        T_map_body=T,
        edge_keyframe_ids=np.column_stack([ids[:-1], ids[1:]]),
        edge_transforms=relative(T[:-1], T[1:]),
        edge_covariances=np.tile(1e4 * np.eye(6), (KEYFRAMES - 1, 1, 1)),
        edge_kinds=(EdgeKind.ODOMETRY,) * (KEYFRAMES - 1),
        observation_keyframe_ids=observers,
        observation_landmark_ids=("0",) * count,
        observation_positions=np.zeros((count, 3)),
        observation_covariances=np.zeros((count, 3, 3)),
    )


def landmarks(moving: int = 0) -> ObjectMapRecord:
    count = 10 + moving
    record = ObjectMapRecord.of_objects(tuple(map(str, range(count))), np.zeros((count, 3)), [0] * count, ("car",))
    states = ("confirmed",) * 10 + ("retired",) * moving
    return replace(record, states=states, reasons=("",) * 10 + ("moving",) * moving)


def doubts(
    graph: FactorGraphRecord, object_map: ObjectMapRecord | None = None, check: TrajectoryCheck = UNDECIDED
) -> str:
    return "; ".join(assess(graph, object_map or landmarks(), CALIBRATION, {}, check))


def test_better_odometry_raises_doubt() -> None:
    check = TrajectoryCheck({"odometry": 1.0, "online": 0.0, "final": 0.0}, "odometry", 100)
    assert "odometry alone is better" in doubts(drive(seen=range(KEYFRAMES)), check=check)


@pytest.mark.parametrize(
    ("driven", "share"),
    [
        ({"seen": range(KEYFRAMES)}, 0),
        ({"seen": range(0, KEYFRAMES, 10)}, 0),  # gaps within the sensor range
        ({"seen": range(50)}, 51),
        ({"seen": range(30, KEYFRAMES)}, 30),
        ({"seen": range(KEYFRAMES), "landmarks": 1}, 100),
        ({"seen": range(0), "step_m": 0.0}, 0),  # it stood still
    ],
)
def test_a_long_way_without_landmarks_is_told(driven: dict[str, Any], share: int) -> None:
    said = doubts(drive(**driven))
    assert f"fewer than two landmarks in view over {share} % of the way" in said if share else said == ""


@pytest.mark.parametrize("hidden", ["", "translations", "rotations"])
def test_odometry_that_tells_no_translations_or_rotations_is_told(hidden: str) -> None:
    angles = np.linspace(0.0, 2.0 * np.pi, KEYFRAMES)
    circle = 30.0 * np.column_stack([np.sin(angles), -np.cos(angles), np.zeros(KEYFRAMES)])
    graph = replace(drive(seen=range(KEYFRAMES)), T_map_body=transform_from_xyz_yaw(circle, angles))
    steps = relative(graph.T_map_body[:-1], graph.T_map_body[1:])
    steps[40, 0, 3] += 90.0  # one jump is no sign
    if hidden == "translations":
        steps[:, :3, 3] = 0.0
    elif hidden == "rotations":
        steps[:, :3, :3] = np.eye(3)
    said = doubts(replace(graph, edge_transforms=steps))
    assert said == "" if not hidden else f"the {hidden} of the odometry are off by 100 %" in said


@pytest.mark.parametrize(("back_to", "landmark", "parts"), [(100, "1", 2), (50, "1", 0), (100, "0", 0)])
def test_parts_of_a_drive_that_nothing_joins_are_told(back_to: int, landmark: str, parts: int) -> None:
    """The odometry breaks off at the 51st keyframe; a closure leads from the last one back to another."""
    graph = drive(seen=range(KEYFRAMES))
    graph.edge_keyframe_ids[-1] = 10 + KEYFRAMES - 2, 10 + back_to
    kinds = [EdgeKind.ODOMETRY] * 50 + [EdgeKind.DISCONTINUITY] + [EdgeKind.ODOMETRY] * 48 + [EdgeKind.LOOP_CLOSURE]
    seen = ("0",) * 102 + (landmark,) * 100
    said = doubts(replace(graph, edge_kinds=tuple(kinds), observation_landmark_ids=seen))
    assert said.startswith(f"the drive is in {parts} parts") if parts else said == ""


@pytest.mark.parametrize(("error_m", "closures", "told"), [(9.9, 1, []), (10.1, 1, ["1 of 1"]), (10.1, 11, [])])
def test_closures_that_the_trajectory_contradicts_are_told(error_m: float, closures: int, told: list[str]) -> None:
    """The first of some closures, with a standard deviation of 1 m, is off."""
    graph = drive(seen=range(KEYFRAMES))
    graph.edge_covariances[:] = np.eye(6)
    graph.edge_transforms[0, 1, 3] = error_m
    kinds = (EdgeKind.LOOP_CLOSURE,) * closures + graph.edge_kinds[closures:]
    said = doubts(replace(graph, edge_kinds=kinds))
    assert re.findall(r"contradicts (\d+ of \d+) closures", said) == told


def test_a_kidnapping_is_no_way_without_landmarks() -> None:
    graph = drive(seen=range(KEYFRAMES))
    graph.T_map_body[50:, 1, 3] = 1000.0
    assert "of the way" in doubts(graph)
    kinds = (*graph.edge_kinds[:49], EdgeKind.DISCONTINUITY, *graph.edge_kinds[50:])
    assert doubts(replace(graph, edge_kinds=kinds)) == ""


def test_keyframes_of_a_fixed_prior_map_are_no_way_without_landmarks() -> None:
    graph = drive(seen=range(60, KEYFRAMES))
    assert "of the way" in doubts(graph)
    assert doubts(with_edges(graph, slice(60, None))) == ""


@pytest.mark.parametrize(
    ("spacing_m", "classes", "said"),
    [
        (61.0, [0, 1, 1, 2, 3], "1 of 4 labels have several landmarks"),
        (61.0, [0, 1, 1, 2, 3, 4], None),
        (59.0, [0, 0, 1, 1], None),
    ],
)
def test_labels_with_several_landmarks(spacing_m: float, classes: list[int], said: str | None) -> None:
    ids, places = tuple(map(str, range(len(classes)))), np.zeros((len(classes), 3))
    object_map = ObjectMapRecord.of_objects(ids, places, classes, tuple("abcde"))
    calibration = CALIBRATION.with_values({"objects.spacing_m": spacing_m, "detection.farthest_m": 30.0})
    found = assess(drive(seen=range(KEYFRAMES)), object_map, calibration, {}, UNDECIDED)
    assert [each.partition(",")[0] for each in found] == ([said] if said else [])


@pytest.mark.parametrize(("moving", "told"), [(3, False), (4, True)])
def test_many_moving_objects_are_told(moving: int, told: bool) -> None:
    said = doubts(drive(seen=range(KEYFRAMES)), landmarks(moving=moving))
    assert ("seem to move" in said) == told


@pytest.mark.parametrize(
    ("counters", "reason"),
    [
        ({"detections_without_odometry": 7}, r"within the time of the odometry \(7 are not\).* the same clock"),
        ({"detections_used": 7}, "no scan has an object"),
        ({"objects_used": 7}, "no landmark was confirmed"),
    ],
)
def test_diagnose_uncorrected_names_the_reason(counters: dict[str, int], reason: str) -> None:
    graph = drive(seen=range(0))
    assert re.search(reason, diagnose_uncorrected(graph, counters))
    assert doubts(graph) == ""  # one reason once
    closed = replace(graph, edge_kinds=(*graph.edge_kinds[:-1], EdgeKind.LOOP_CLOSURE))
    assert diagnose_uncorrected(closed, counters) == diagnose_uncorrected(drive(seen=range(5)), counters) == ""
