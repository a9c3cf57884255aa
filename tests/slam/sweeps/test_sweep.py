"""Sweeps over a short drive: cells are computed once, whatever happens between."""

from __future__ import annotations

import json
import os
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from logs.messages import GroundTruthPose
from slam.common.config import Config
from slam.common.config_tree import load_tree
from slam.common.errors import EvaluationError
from slam.evaluation.evaluate import evaluate
from slam.evaluation.inputs.records import read_records
from slam.replay import replay
from slam.simulation.faults.faulty_log import write_faulty
from slam.sweeps.cells import Cell, CellFolder, CellResult
from slam.sweeps.degradations import cases_of, parse_degradations
from slam.sweeps.outputs import to_markdown, write_outputs
from slam.sweeps.sweep import Sweep, run_sweep, spread_over
from tests.helpers.short_drives import Entry, change, keep_until, write_log

pytestmark = pytest.mark.slow

SPECIFICATIONS = ("dropout=0.3", "field_of_view=120")


@pytest.fixture(scope="module")
def log(noisy_drive: list[Entry], tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_log(tmp_path_factory.mktemp("sweep") / "drive.mcap", keep_until(noisy_drive, 5.0))


@pytest.fixture(scope="module")
def finished(log: Path) -> tuple[Path, Sweep]:
    """A folder with a whole sweep in it; tests copy what they change."""
    folder = log.parent / "whole"
    sweep = sweep_over(log, folder)
    write_outputs(folder, sweep)
    return folder, sweep


def sweep_over(
    log: Path, folder: Path, specifications: Sequence[str] = SPECIFICATIONS, *overrides: str, seeds: int = 2
) -> Sweep:
    config = load_tree(Config, None, overrides)
    return run_sweep(log, folder, parse_degradations(specifications), config, seeds=seeds, jobs=1)


def cells_of(sweep: Sweep, degradation: str) -> list[tuple[Cell, CellResult]]:
    return [pair for pair in sweep.results.items() if pair[0].degradation == degradation]


def without_times(told: Mapping[str, Any]) -> dict[str, Any]:
    return {key: value for key, value in told.items() if key != "times"}


def modified_ns(folder: Path) -> dict[str, int]:
    return {path.name: path.stat().st_mtime_ns for path in (folder / "cells").iterdir()}


def test_a_cell_is_what_the_three_commands_make(log: Path, finished: tuple[Path, Sweep], tmp_path: Path) -> None:
    (cell, result) = cells_of(finished[1], "dropout=0.3")[1]
    assert cell.seed == 1
    degradation = parse_degradations(SPECIFICATIONS)[1]
    write_faulty(log, tmp_path / "degraded.mcap", cases_of(degradation), seed=1)
    replay(tmp_path / "degraded.mcap", tmp_path / "map.mcap", Config())
    expected = evaluate(read_records(tmp_path / "map.mcap")).to_json_dict()
    assert json.loads(json.dumps(result.evaluation)) == json.loads(json.dumps(expected))
    told = json.loads((finished[0] / "cells" / cell.file_name).read_text())
    assert told["evaluation"] == json.loads(json.dumps(expected))
    assert (told["degradation"], told["seed"]) == ("dropout=0.3", 1)


def test_seeds_are_used_only_for_random_degradations(finished: tuple[Path, Sweep]) -> None:
    rows = finished[1].rows()
    assert [len(cells) for cells in rows.values()] == [1, 2, 1]
    spread = spread_over(rows["", "dropout=0.3"], "trajectory.ate_m")
    assert spread.count == 2
    assert spread.standard_deviation is not None
    assert spread.standard_deviation > 0.0


def test_a_finished_sweep_is_not_computed_again(log: Path, finished: tuple[Path, Sweep]) -> None:
    """Nor is anything kept that a process left behind that was killed."""
    folder, sweep = finished
    before = modified_ns(folder)
    (folder / "cells" / "unfinished").mkdir()
    (folder / "cells" / "unfinished" / "map.mcap.part").write_text("left behind")
    (folder / "cells" / "dropout.json.part").write_text("left behind")
    again = sweep_over(log, folder)
    assert (sweep.computed, again.computed) == (4, 0)
    assert modified_ns(folder) == before
    assert without_times(again.to_json_dict()) == without_times(sweep.to_json_dict())
    assert to_markdown(again) == to_markdown(sweep)


def test_more_seeds_compute_only_what_is_new(log: Path, tmp_path: Path) -> None:
    assert sweep_over(log, tmp_path, ["dropout=0.5"], seeds=1).computed == 2
    assert sweep_over(log, tmp_path, ["dropout=0.5"], seeds=2).computed == 1


def test_the_key_depends_on_all_that_the_result_does(finished: tuple[Path, Sweep]) -> None:
    cell = finished[1].first
    other = [
        replace(cell, seed=7),
        replace(cell, degradation=parse_degradations(["dropout=0.31"])[1]),
        replace(cell, sha256="0" * 64),
        replace(cell, version="9"),
        replace(cell, config=load_tree(Config, None, ["keyframe.distance_m=3.0"])),
        replace(cell, topics=(("odometry", "/wheels"),)),
        replace(cell, variant="other"),
    ]
    assert len({cell.key, *(each.key for each in other)}) == 1 + len(other)
    assert replace(cell, log=Path("elsewhere.mcap")).key == cell.key


def test_a_cell_cut_short_or_failed_is_computed_again(log: Path, finished: tuple[Path, Sweep], tmp_path: Path) -> None:
    (first, result), (second, _) = cells_of(finished[1], "dropout=0.3")
    with CellFolder(tmp_path).opened() as kept:
        kept.keep(first, result)
        assert kept.finished(first) is not None
        assert kept.finished(second) is None
        path = tmp_path / "cells" / first.file_name
        path.write_text(path.read_text()[:1000])
        assert kept.finished(first) is None
        kept.keep(first, replace(result, evaluation=None, error="no space left on device"))
        assert kept.finished(first) is None


def test_a_failing_cell_is_recorded_and_stops_no_other(log: Path, tmp_path: Path) -> None:
    sweep = sweep_over(log, tmp_path, ["keep_label=unicorn", "field_of_view=90"])
    (failure,) = sweep.failures
    assert failure.startswith("keep_label=unicorn, seed 0: ")
    assert "no detection is labelled 'unicorn'" in failure
    assert [spread_over(cells, "trajectory.ate_m").count for cells in sweep.rows().values()] == [1, 0, 1]
    assert f"- failed: {failure}" in to_markdown(sweep)
    told = sweep.to_json_dict()
    assert told["degradations"][1]["cells"][0]["error"] in failure
    json.dumps(told, allow_nan=False)
    write_outputs(tmp_path, sweep)
    assert sweep_over(log, tmp_path, ["keep_label=unicorn", "field_of_view=90"]).computed == 1


def test_two_sweeps_do_not_share_a_folder(log: Path, tmp_path: Path) -> None:
    with CellFolder(tmp_path).opened(), pytest.raises(EvaluationError, match="another sweep"):
        sweep_over(log, tmp_path)


def test_a_drive_with_truth_is_needed(log: Path, noisy_drive: list[Entry], tmp_path: Path) -> None:
    blind = change(keep_until(noisy_drive, 2.0), GroundTruthPose, lambda _, __: None)
    with pytest.raises(EvaluationError, match="no ground truth"):
        sweep_over(write_log(tmp_path / "blind.mcap", blind), tmp_path / "out")
    replay(log, tmp_path / "map.mcap", Config())
    with pytest.raises(EvaluationError, match="give the drive"):
        sweep_over(tmp_path / "map.mcap", tmp_path / "out")
    assert not (tmp_path / "out").exists()


def test_the_json_names_what_it_was_made_from(log: Path, finished: tuple[Path, Sweep]) -> None:
    folder, sweep = finished
    told = json.loads((folder / "sweep.json").read_text())
    assert told == json.loads(json.dumps(sweep.to_json_dict()))
    assert told["input"]["log"] == log.name
    assert [each["name"] for each in told["degradations"]] == ["undegraded", *SPECIFICATIONS]
    assert told["degradations"][2]["cells"][0]["reported"].startswith("optimised")
    assert all(os.path.exists(folder / "cells" / name) for name in told["times"]["cells"])
    assert (folder / "sweep.md").read_text().count("\n| dropout=0.3 | 2 |") == 1


def test_variants_are_compared_over_the_same_drives(log: Path, tmp_path: Path) -> None:
    settings = {"fine": "keyframe.distance_m=1.0", "coarse": "keyframe.distance_m=4.0"}
    variants = {name: load_tree(Config, None, [text]) for name, text in settings.items()}
    wanted = parse_degradations(("dropout=0.3",))
    sweep = run_sweep(log, tmp_path, wanted, Config(), seeds=1, jobs=1, variants=variants)
    assert list(sweep.rows()) == [(variant, degradation) for variant in settings for degradation in wanted]
    assert sweep.computed == 2 * len(wanted)
    assert len({cell.file_name for cell in sweep.results}) == len({cell.name for cell in sweep.results}) == 4
    counts = {cell.variant: result.evaluation["counters"]["keyframes"] for cell, result in sweep.results.items()}
    assert counts["fine"] > counts["coarse"]
    told = sweep.to_json_dict()
    assert told["variants"] == {name: [text] for name, text in settings.items()}
    write_outputs(tmp_path, sweep)
    assert "dropout=0.3: coarse" in (tmp_path / "sweep.csv").read_text(encoding="utf-8")
