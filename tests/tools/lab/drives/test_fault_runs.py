"""A tiny drive, mapped with faults, each in a process of its own."""

from __future__ import annotations

import os
import signal
from dataclasses import replace
from pathlib import Path

import pytest

from slam.common.config import Config
from slam.common.errors import EvaluationError
from slam.simulation.faults.registry import all_cases
from tests.helpers.short_drives import Entry, keep_until, write_log
from tools.lab.drives import fault_runs as module
from tools.lab.drives.fault_runs import CLEAN, FaultTask, benchmark_faults, run_fault
from tools.lab.drives.fault_table import HEADINGS, render_markdown, table_row

pytestmark = pytest.mark.slow


@pytest.fixture(scope="module")
def log(noisy_drive: list[Entry], tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_log(tmp_path_factory.mktemp("tiny") / "tiny.mcap", keep_until(noisy_drive, 5.0))


def task(log: Path, fault: str, folder: Path) -> FaultTask:
    return FaultTask(log, Config(), {}, fault, 0, folder)


def test_the_drive_as_it_is_and_each_fault(log: Path) -> None:
    runs = list(benchmark_faults(log, all_cases(["heading_jump=90", "lengths_scaled=20"]), Config()))
    clean, turned, scaled = runs
    assert [run.fault for run in runs] == [CLEAN, "heading_jump=90:0.5", "lengths_scaled=20"]
    assert not any(run.error for run in runs)
    assert clean.ate_m is not None
    assert clean.odometry_ate_m is not None
    assert turned.odometry_ate_m is not None
    assert scaled.odometry_ate_m is not None
    assert clean.ate_m < 0.5
    assert turned.odometry_ate_m > 10 * clean.odometry_ate_m
    # The truth is scaled as the odometry is.
    assert scaled.odometry_ate_m == pytest.approx(20.0 * clean.odometry_ate_m, rel=1e-3)
    assert clean.final_status
    assert clean.counters["odometry_used"] > 0
    assert clean.landmarks == clean.counters["landmarks_confirmed"]


def test_a_run_is_the_same_again_but_for_its_time(log: Path, tmp_path: Path) -> None:
    first, second = (run_fault(task(log, "unreported_noise=0.5", tmp_path)) for _ in range(2))
    assert replace(first, seconds=None) == replace(second, seconds=None)
    assert not list(tmp_path.iterdir())


def test_what_cannot_be_mapped_is_a_row(log: Path, tmp_path: Path) -> None:
    run = run_fault(task(log, "no_such_fault", tmp_path))
    assert "no_such_fault" in run.error
    assert run.ate_m is None
    cells = dict(zip(HEADINGS, table_row(run, "reported"), strict=True))
    assert cells["reported"] == f"error: {run.error}"
    assert cells["ATE m"] == "–"


def test_what_should_not_happen_is_a_row(log: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def fail(*_: object, **__: object) -> None:
        raise ZeroDivisionError("broken")

    monkeypatch.setattr(module, "replay", fail)
    assert run_fault(task(log, CLEAN, tmp_path)).error == "this should not happen: ZeroDivisionError: broken"


def die(_: FaultTask) -> None:
    os.kill(os.getpid(), signal.SIGKILL)


def test_a_process_that_dies_is_a_row(log: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(module, "run_fault", die)
    runs = list(benchmark_faults(log, all_cases(["labels_unique"]), Config()))
    assert [run.fault for run in runs] == [CLEAN, "labels_unique"]
    assert all(f"exit code {-signal.SIGKILL}" in run.error for run in runs)


def test_a_drive_without_truth_is_refused(noisy_drive: list[Entry], tmp_path: Path) -> None:
    kept = [entry for entry in keep_until(noisy_drive, 1.0) if not entry[0].startswith("/ground_truth")]
    with pytest.raises(EvaluationError, match="no true poses"):
        list(benchmark_faults(write_log(tmp_path / "log.mcap", kept), [], Config()))


def test_a_table_for_people() -> None:
    rows = [table_row(module.FaultRun("labels_unique", ate_m=0.12345, closures_accepted=3, seconds=7.4), "a | b")]
    text = render_markdown(Path("folder/drive.mcap"), 4, rows)
    assert text.startswith("# Faults of the input of drive.mcap, seed 4\n")
    assert "| labels_unique | 0.123 | – | 3 | – | – | – | a \\| b | 7 |\n" in text
    assert len({line.replace("\\|", "").count("|") for line in text.splitlines()[2:]}) == 1
