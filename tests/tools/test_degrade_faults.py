"""Faults as they are typed: dslam degrade --fault."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from logs.reader import LogReader
from slam.simulation.faults.registry import FAULTS
from tests.helpers.short_drives import Entry, keep_until, write_log
from tests.tools.runs import SAMPLE, Run, assert_refused


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
        assert_refused(dslam(*degrade, "heading_jump=much"), "'much'", "a valid number")
        assert_refused(dslam(*degrade, "labels_unique=3"), "takes no value")
        assert not list(tmp_path.iterdir())
