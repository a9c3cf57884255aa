from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from logs.messages import (
    GroundTruthPose,
    LoopClosureRecord,
    Odometry,
    SlamPose,
    StatusRecord,
    TrajectoryRecord,
    Transform,
)
from slam.common.arrays import FloatArray
from slam.common.geometry import apply, invert, make_transform, transform_from_xyz_yaw
from slam.evaluation.evaluate import Evaluation, evaluate
from slam.evaluation.inputs.records import EvaluationRecords, collect_records, read_records
from slam.evaluation.report.picture import compose_picture
from tests.helpers.short_drives import write_records
from tests.slam.evaluation.drives import stamps, winding_path
from tests.slam.evaluation.maps import frames, object_map
from tests.slam.evaluation.results import Log, associated, at_json, graph, measured, with_field, without

COUNT = 400
NOTHING = pytest.approx(0.0, abs=1e-9)
PARTS = {*("trajectory", "odometry", "online", "associations", "landmarks"), *("closures", "relocalization")}
T_WORLD_MAP = transform_from_xyz_yaw(np.array([20.0, 30.0, 1.0]), 0.7)


def made_log() -> Log:
    """400 m: odometry 1 % too long, a perfect estimate, ten objects seen three times each, one sighting missed."""
    at, T_gt = stamps(COUNT).tolist(), winding_path(COUNT)
    T_map_body = invert(T_WORLD_MAP) @ T_gt
    T_odom = T_map_body.copy()
    T_odom[:, :3, 3] *= 1.01
    log: Log = []
    for t, gt, est, odom in zip(at, T_gt, T_map_body, T_odom, strict=True):
        log.append(("/odom", Odometry(t, odom)))
        log.append(("/ground_truth", GroundTruthPose(t, gt)))
        log.append(("/slam/pose", SlamPose(t, est)))
    names, ids = tuple(map(str, range(10))), tuple(f"o{index}" for index in range(10))
    sightings, at_frames = [], []
    for index, (truth, landmark) in enumerate(zip(ids, names, strict=True)):
        for k in range(3):
            missed = index == 9 and k == 2
            sightings.append([(truth, "" if missed else landmark, k == 0)])
            at_frames.append(at[index * 10 + k])
    log += associated(frames(*sightings, stamps_ns=at_frames))
    positions = winding_path(COUNT)[:100:10, :3, 3] + np.random.default_rng(0).uniform(-5, 5, (10, 3))
    labels = ("tree",) * 9 + ("pole",)
    log.append(("/ground_truth/objects", object_map(ids, positions, labels)))
    first = np.array(at_frames[::3], int)
    in_map = apply(invert(T_WORLD_MAP), positions)
    log.append(("/slam/map", object_map(names, in_map + 99.0, labels, first_seen_ns=first)))
    log.append(("/slam/map", object_map(names, in_map, ("tree",) * 10, first_seen_ns=first)))
    log.append(("/slam/trajectory_stamped", TrajectoryRecord(at[-1], "map", stamps(COUNT), T_map_body)))
    T_reference_query = invert(T_map_body[10]) @ T_map_body[300]
    right = LoopClosureRecord(at[300], 150, 5, True, "accepted", "", 9, 1.0, T_reference_query, None, at[10])
    wrong = replace(right, T_reference_query=np.eye(4), reference_keyframe_id=10, reference_stamp_ns=at[20])
    log.append(("/slam/closures", replace(right, accepted=False, stage="consistency", reason="waits for others")))
    log.append(("/slam/closures", wrong))
    log.append(("/slam/closures", replace(right, inserted=True)))
    log.append(("/slam/closures", LoopClosureRecord(at[302], 151, 5, False, "retrieval", "too far")))
    log.append(("/slam/graph", graph(stamps(COUNT)[::2], T_map_body[::2])))
    log.append(("/slam/status", StatusRecord(at[0], "mapping", "info", "", {"keyframes": 1})))
    log.append(("/slam/status", StatusRecord(at[-1], "done", "info", "", {"keyframes": 200})))
    return log


MADE = made_log()


@pytest.fixture(scope="module")
def complete() -> Evaluation:
    return measured(MADE)


def with_truth(alter: Callable[[FloatArray], FloatArray]) -> Log:
    """The log with other true poses."""
    return with_field(MADE, GroundTruthPose, "T_world_body", alter)


def test_all_parts_of_a_complete_log(complete: Evaluation) -> None:
    assert PARTS.isdisjoint(complete.unavailable)
    expected = {
        "trajectory.ate_m": NOTHING,
        "trajectory.online_ate_m": NOTHING,
        # 1 % of the straight distance, which on a winding road is a little less than the path.
        "trajectory.odometry_rpe_translation_percent": pytest.approx(0.93, abs=0.01),
        "associations.recall": 19 / 20,
        "landmarks.median_error_m": NOTHING,
        "landmarks.class_accuracy": 9 / 10,
        "landmarks.recall": None,  # no object was detected five times
        "closures.stage_counts": {"retrieval": 1, "accepted": 2},
        "closures.precision": 0.5,
        "relocalization.loss_count": 0,
        "counters.keyframes": 200,
        "protocol.revisit_m": 100.0,
    }
    assert {path: at_json(complete, path) for path in expected} == expected


def test_truth_of_a_body_with_other_axes(complete: Evaluation) -> None:
    """NED: x ahead, y to the right and z down."""
    result = measured(with_truth(lambda T: T @ np.diag([1.0, -1.0, -1.0, 1.0])))
    assert at_json(result, "trajectory.true_axes") == "roll 180, pitch 0, yaw 0 deg"
    assert at_json(complete, "trajectory.true_axes") is None
    assert at_json(result, "closures.precision") == at_json(complete, "closures.precision") == 0.5
    assert at_json(result, "trajectory.rpe_rotation_deg_per_100m") == pytest.approx(0.0, abs=1e-6)


def test_truth_of_the_positions_of_an_antenna(complete: Evaluation) -> None:
    antenna_m = np.array([3.0, -0.5, 1.2])
    result = measured(with_truth(lambda T: make_transform(np.eye(3), apply(T, antenna_m[None])[0])))
    assert at_json(result, "trajectory.true_point_ahead_m") == pytest.approx(3.0, abs=0.05)
    assert at_json(result, "trajectory.true_point_left_m") == pytest.approx(-0.5, abs=0.05)
    assert at_json(complete, "trajectory.true_point_ahead_m") is None
    assert at_json(result, "trajectory.ate_m") == pytest.approx(0.0, abs=0.02)
    assert at_json(result, "trajectory.rpe_rotation_deg_per_100m") is None
    assert at_json(result, "closures.precision") == at_json(complete, "closures.precision") == 0.5
    assert result.unavailable["calibration"].startswith("the truth has positions only")


def test_truth_of_a_body_that_never_turns() -> None:
    def unturned(T: FloatArray) -> FloatArray:
        return make_transform(np.eye(3), T[..., :3, 3])

    log = with_field(with_truth(unturned), TrajectoryRecord, "T_map_body", unturned)
    assert at_json(measured(log), "trajectory.true_point_ahead_m") is None


def test_unmeasured_parts_are_empty_with_reason() -> None:
    result = measured(without(MADE, "/ground_truth"))
    assert at_json(result, "trajectory.ate_m") is None
    assert at_json(result, "associations") == at_json(result, "landmarks") == {}
    assert PARTS & set(result.unavailable) == PARTS - {"relocalization"}
    assert at_json(result, "closures.accepted_count") == 2
    assert at_json(result, "closures.precision") is None
    assert "--reference" in result.unavailable["trajectory"]
    assert "truth of the detections" in result.unavailable["associations"]


def test_an_unfinished_run_is_measured_by_its_online_poses() -> None:
    result = measured(without(MADE, "/slam/trajectory"))
    assert "finished" in result.unavailable["trajectory"]
    assert at_json(result, "trajectory.online_ate_m") == NOTHING
    assert at_json(result, "landmarks.global_median_error_m") == NOTHING


def test_revisits_need_keyframes() -> None:
    result = measured(without(MADE, "/slam/graph"))
    assert "/slam/graph" in result.unavailable["closures"]
    assert at_json(result, "closures.precision") == 0.5
    assert "recall" not in result.to_json_dict()["closures"]


def test_a_reference_of_another_drive_is_told() -> None:
    records = collect_records(MADE)
    late = replace(records.true_path, stamps_ns=records.true_path.stamps_ns + 10**13)
    truths = [replace(r, stamp_ns=r.stamp_ns + 10**13) for r in records.detection_truths]
    other = EvaluationRecords(true_path=late, detection_truths=tuple(truths))
    result = evaluate(records.with_truth_of(other))
    assert at_json(result, "trajectory.ate_m") is None
    assert "truth of this drive" in result.unavailable["trajectory"]
    assert "another drive" in result.unavailable["associations"]


def test_from_a_file_and_a_reference(complete: Evaluation, tmp_path: Path) -> None:
    out, reference = tmp_path / "out.mcap", tmp_path / "reference.mcap"
    write_records(out, without(MADE, "/ground_truth"))
    write_records(reference, without(MADE, "/slam"))
    from_file = evaluate(read_records(out, reference=reference))
    assert PARTS.isdisjoint(from_file.unavailable)
    for path in ("trajectory.odometry_ate_m", "associations.recall", "landmarks.class_accuracy"):
        assert at_json(from_file, path) == pytest.approx(at_json(complete, path), rel=1e-6)


def drawn(records: EvaluationRecords) -> dict[str, FloatArray]:
    """Positions (N, 2) of lines and marks by their names in the key."""
    (axes,) = compose_picture(records, evaluate(records), "map").figure.axes
    lines = {str(line.get_label()): np.asarray(line.get_xydata()) for line in axes.lines}
    marks = {str(marks.get_label()): np.asarray(marks.get_offsets()) for marks in axes.collections}
    return {name.partition(" (")[0]: positions for name, positions in (lines | marks).items()}


def test_the_picture_is_in_the_map_frame() -> None:
    layers = drawn(collect_records(MADE))
    path = layers["estimate"]
    np.testing.assert_allclose(layers["ground truth"], path, atol=1e-9)
    np.testing.assert_allclose(layers["odometry"][0], path[0], atol=1e-9)
    np.testing.assert_allclose(layers["true loop closures"][:2], path[[300, 10]], atol=1e-9)
    np.testing.assert_allclose(layers["false loop closures"][:2], path[[300, 20]], atol=1e-9)
    assert "loop closures" not in layers
    assert len(layers["tree"]) == 10


def test_a_lost_robot_is_marked_before_the_discontinuity_and_not_where_it_was_noticed() -> None:
    at = stamps(COUNT).tolist()
    lost, found = StatusRecord(at[110], "LOST", "warning", ""), StatusRecord(at[120], "RELOCALIZED", "info", "")
    records = collect_records([*MADE, ("/slam/status", lost), ("/slam/status", found)])
    assert records.graph is not None
    kept = records.graph.keyframe_ids[50:52].reshape(1, 2)
    jump = {"edge_transforms": np.eye(4)[None], "edge_covariances": np.eye(6)[None], "edge_kinds": ("discontinuity",)}
    records = replace(records, graph=replace(records.graph, edge_keyframe_ids=kept, **jump))
    layers = drawn(records)
    np.testing.assert_allclose(layers["lost"][0], records.final_path.positions[100, :2], atol=1e-9)
    np.testing.assert_allclose(layers["found"][0], records.final_path.positions[120, :2], atol=1e-9)


def test_of_a_given_map_the_picture_shows_what_is_around_the_path() -> None:
    records = collect_records(MADE)
    assert records.object_map is not None
    positions = records.object_map.positions.copy()
    positions[0] += [2.0 * COUNT, 0.0, 0.0]
    records = replace(records, object_map=replace(records.object_map, positions=positions))
    assert len(drawn(records)["tree"]) == 10
    assert len(drawn(replace(records, provenance={"map_drives": "[]"}))["tree"]) == 9


def test_odometry_is_taken_from_where_the_replay_took_it(tmp_path: Path) -> None:
    records = [("/wheels", Odometry(1, np.eye(4))), ("/tf", Transform(2, "odom", "base_link", np.eye(4)))]
    path = write_records(tmp_path / "log.mcap", records, dslam={"topics": '{"/tf": ["odometry"]}'})
    assert read_records(path).odometry_path.stamps_ns.tolist() == [2]
    assert read_records(path, topics={"odometry": "/wheels"}).odometry_path.stamps_ns.tolist() == [1]


@pytest.mark.parametrize("recorded", ["no json", '{"/odom": null}', '{"/gone": ["odometry"]}'])
def test_a_record_of_topics_that_is_none_is_passed_over(tmp_path: Path, recorded: str) -> None:
    path = write_records(tmp_path / "log.mcap", [("/odom", Odometry(0, np.eye(4)))], dslam={"topics": recorded})
    assert len(read_records(path).odometry_path) == 1
