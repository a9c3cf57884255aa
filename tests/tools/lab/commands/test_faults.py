"""Faults as they are typed: dslam degrade --fault, and dslam benchmark faults."""

from __future__ import annotations

import json
from pathlib import Path
from types import SimpleNamespace

import pytest

from logs.reader import LogReader
from slam.simulation.faults.registry import FAULTS
from slam.sweeps.mapped_drive import MappedDrive
from tests.helpers.short_drives import Entry, keep_until, write_log
from tests.tools.runs import SAMPLE, Run, assert_refused
from tools.lab.commands.faults import report_of


@pytest.fixture(scope="module")
def tiny(noisy_drive: list[Entry], tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_log(tmp_path_factory.mktemp("tiny") / "tiny.mcap", keep_until(noisy_drive, 4.0))


def metadata_of(path: Path) -> dict[str, dict[str, str]]:
    with LogReader(path) as reader:
        return reader.metadata()


class TestDegrade:
    def test_the_list_tells_every_fault_and_its_meaning(self, dslam: Run) -> None:
        result = dslam("degrade", "--list-faults")
        assert (result.code, result.err) == (0, "")
        told = " ".join(result.out.split())
        assert all(f"{fault.usage} {fault.meaning}" in told for fault in FAULTS.values())

    def test_faults_are_put_in_in_their_order(self, dslam: Run, tiny: Path, tmp_path: Path) -> None:
        output = tmp_path / "out.mcap"
        typed = ("--fault", "heading_jump=30", "--fault", "labels_unique", "--seed", 3)
        result = dslam("degrade", tiny, "-o", output, *typed, "--json")
        assert (result.code, result.err) == (0, "")
        told = json.loads(result.out)
        assert told["faults"] == ["heading_jump=30:0.5", "labels_unique"]
        assert told["message_counts"]["/odom"] > 0
        assert metadata_of(output)["faults"]["faults"] == "heading_jump=30:0.5 labels_unique"
        assert metadata_of(output)["faults"]["seed"] == "3"

    def test_a_summary_for_people(self, dslam: Run, tiny: Path, tmp_path: Path) -> None:
        result = dslam("degrade", tiny, "-o", tmp_path / "out.mcap", "--fault", "labels_one_class")
        assert result.code == 0
        assert f"labels_one_class: {FAULTS['labels_one_class'].meaning}" in result.out

    def test_refusals(self, dslam: Run, tmp_path: Path) -> None:
        degrade = ("degrade", SAMPLE, "-o", tmp_path / "out.mcap", "--fault")
        assert_refused(dslam(*degrade, "heading_jmp"), "heading_jmp", "did you mean heading_jump")
        assert_refused(dslam(*degrade, "heading_jump=much"), "'much'", "a number")
        assert_refused(dslam(*degrade, "labels_unique=3"), "takes no value")
        assert not list(tmp_path.iterdir())


class TestBenchmark:
    @pytest.mark.slow
    def test_table_has_figures_and_reports_of_each_fault(self, dslam: Run, tiny: Path) -> None:
        only = ("--only", "stamps_in_microseconds", "--only", "sensor_yaw=90")
        result = dslam("benchmark", "faults", tiny, *only, "--jobs", 2, "--markdown")
        rows = [line.split(" | ") for line in result.out.splitlines()[2:]]
        assert [row[0] for row in rows] == ["| none", "| stamps_in_microseconds", "| sensor_yaw=90"]
        assert rows[0][7] == "optimised"
        assert "detections without odometry" in rows[1][7]
        assert "3 of 3: " in result.err

    @pytest.mark.slow
    def test_json(self, dslam: Run, tiny: Path) -> None:
        result = dslam("benchmark", "faults", tiny, "--only", "labels_case", "--json", "--set", "keyframe.distance_m=1")
        told = json.loads(result.out)
        assert [run["name"] for run in told["runs"]] == ["none", "labels_case"]
        assert all(run["evaluation"]["trajectory"]["ate_m"] is not None and run["reported"] for run in told["runs"])

    def test_refusals(self, dslam: Run, tiny: Path, tmp_path: Path) -> None:
        benchmark = ("benchmark", "faults", tiny)
        assert_refused(dslam(*benchmark, "--only", "labels"), "there is no fault 'labels'")
        assert_refused(dslam(*benchmark, "--set", "no.such=1"), "no.such")
        assert_refused(dslam("benchmark", "faults", tmp_path / "none.mcap"), "No such file")

    def test_what_the_user_is_told(self) -> None:
        counters = {"closures_removed": 3, "closures_rejected_by_odometry": 2, "odometry_breaks": 1, "keyframes": 9}
        summary = SimpleNamespace(final_status="optimised", counters=counters, notes=())
        told = report_of(MappedDrive("odometry_wild", summary, warnings=("lost",)))
        assert told.startswith("optimised; odometry breaks 1; 3 closures removed as outliers; 2 more rejected")
        assert told.endswith("; lost")
