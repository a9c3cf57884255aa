"""Sweeps over a short drive: drives are mapped once, whatever happens between."""

import json
from collections.abc import Iterator, Sequence
from dataclasses import replace
from pathlib import Path

import pytest

from logs.container.json_text import plain
from logs.messages import GroundTruthPose
from slam.common.config import Config
from slam.common.config_tree import load_tree
from slam.common.errors import ConfigurationError, EvaluationError
from slam.sweeps.mapped_drive import DriveTask, MappedDrive
from slam.sweeps.sweep import DEFAULT_DEGRADATIONS, EVERY_FAULT, Sweep, plan_sweep, result_name, run_sweep
from tests.helpers.short_drives import change, keep_until, write_log

DEGRADATIONS = ("", "dropout=0.3", "keep_label=unicorn")


def map_nothing(task: DriveTask) -> MappedDrive:
    if "unicorn" in task.faults:
        return MappedDrive(error="no unicorn")
    trajectory = {"ate_m": 0.1 * (task.seed + 1)}
    return MappedDrive({"trajectory": trajectory}, ("optimised",), 5.0, 1.0, 1.0)


def compute_inline(_: object, tasks: Sequence[DriveTask], *, jobs: int) -> Iterator[tuple[DriveTask, MappedDrive]]:
    yield from ((task, map_nothing(task)) for task in tasks)


def sweep_over(log: Path, folder: Path, seeds: int = 2) -> Sweep:
    tasks = plan_sweep(log, DEGRADATIONS, {"": Config()}, seeds=seeds)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("slam.sweeps.sweep.compute_all", compute_inline)
        return run_sweep(tasks, folder, jobs=1)


def named(log: Path, *degradations: str) -> list[str]:
    return [task.faults for task in plan_sweep(log, degradations, {"": Config()}, seeds=1)]


def test_each_degradation_is_planned_once_and_random_ones_for_every_seed(short_log):
    assert named(short_log, "gyro_bias,field-of-view=90, keep_label=tree:lamp", "", "dropout=.30", "dropout=0.3") == [
        "gyro_bias=3:10,field_of_view=90,keep_label=tree:lamp",
        "",
        "dropout=0.3",
    ]
    tasks = plan_sweep(short_log, ["", *DEFAULT_DEGRADATIONS], {"a": Config(), "b": Config(calibrate=False)}, seeds=2)
    assert len(tasks) == 2 * (1 + 2 * len(DEFAULT_DEGRADATIONS))
    assert {"heading_jump=30:0.5", "labels_random", "messages_twice"} < set(named(short_log, EVERY_FAULT))
    with pytest.raises(ConfigurationError, match="did you mean dropout"):
        named(short_log, "drop=0.3")


def test_finished_drives_are_not_mapped_again(short_log, tmp_path):
    first = sweep_over(short_log, tmp_path)
    again = sweep_over(short_log, tmp_path)
    assert (first.computed, again.computed) == (4, 1)  # the one that failed
    assert again.results == first.results
    assert sweep_over(short_log, tmp_path, seeds=3).computed == 2
    for path in (tmp_path / "cells").glob("dropout*"):
        path.write_text(path.read_text()[:100])
    assert sweep_over(short_log, tmp_path).computed == 3


def test_groups_hold_the_seeds_and_failures_are_named(short_log, tmp_path):
    sweep = sweep_over(short_log, tmp_path)
    assert sweep.failures == ["keep_label=unicorn, seed 0: no unicorn"]
    told = json.loads(json.dumps(plain(sweep.to_json_dict()), allow_nan=False))
    none, dropout, unicorn = (f"faults={name or 'none'}" for name in DEGRADATIONS)
    assert list(told["groups"]) == [none, dropout, unicorn]
    assert [each["group"] for each in told["runs"]] == [none, dropout, dropout, unicorn]
    assert told["groups"][dropout]["trajectory.ate_m"]["mean"] == pytest.approx(0.15)
    assert told["runs"][-1]["error"] == "no unicorn"
    assert told["runs"][0]["reported"] == ["optimised"]


def test_the_name_of_a_result_depends_on_all_that_it_is_made_from(short_log):
    (task,) = plan_sweep(short_log, [""], {"": Config()}, seeds=1)
    other = [
        replace(task, seed=7),
        replace(task, faults="messages_twice"),
        replace(task, config=load_tree(Config, None, ["keyframe.distance_m=3.0"])),
        replace(task, topics=(("odometry", "/wheels"),)),
        replace(task, variant="other"),
    ]
    assert len({result_name(each, "a") for each in (task, *other)}) == 1 + len(other)
    assert result_name(replace(task, log=Path("elsewhere.mcap")), "a") == result_name(task, "a")


def test_a_drive_with_truth_is_needed(short_log, noisy_drive, tmp_path):
    blind = change(keep_until(noisy_drive, 2.0), GroundTruthPose, lambda _, __: None)
    with pytest.raises(EvaluationError, match="no ground truth"):
        sweep_over(write_log(tmp_path / "blind.mcap", blind), tmp_path / "out")
    assert not (tmp_path / "out").exists()
