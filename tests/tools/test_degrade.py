"""dslam degrade, as it is typed."""

from __future__ import annotations

import json
from pathlib import Path

from logs.reader import LogReader
from slam.simulation.faults.registry import FAULTS
from tests.tools.runs import SAMPLE, Run, assert_refused, write_log

DETECTIONS = 3313
TREES = 1257


def metadata_of(path: Path) -> dict[str, dict[str, str]]:
    with LogReader(path) as reader:
        return reader.metadata()


def test_faults_are_applied_in_their_order_and_recorded(dslam: Run, tmp_path: Path) -> None:
    output = tmp_path / "out.mcap"
    faults = ["position_noise=0.2", "dropout=0.3", "keep_label=tree:bench", "reversed", "false_positives=1.5"]
    typed = [part for fault in faults for part in ("--fault", fault)]
    result = dslam("degrade", SAMPLE, "-o", output, *typed, "--seed", 3, "--json")
    assert (result.code, result.err) == (0, "")
    report = json.loads(result.out)
    assert report["faults"] == faults
    assert report["seed"] == 3
    assert 0 < report["detections"] < report["detections_before"] == DETECTIONS
    assert metadata_of(output)["faults"]["faults"] == " ".join(faults)
    assert metadata_of(output)["faults"]["seed"] == "3"
    assert metadata_of(output)["simulation"] == metadata_of(SAMPLE)["simulation"]


def test_a_summary_for_people(dslam: Run, tmp_path: Path) -> None:
    result = dslam("degrade", SAMPLE, "-o", tmp_path / "out.mcap", "--fault", "drop_label=tree")
    assert result.code == 0
    assert f"{DETECTIONS - TREES} after, {DETECTIONS} before" in result.out
    assert f"drop_label=tree: {FAULTS['drop_label'].meaning}" in result.out
    assert [path.name for path in tmp_path.iterdir()] == ["out.mcap"]


def test_list_has_every_fault_with_its_meaning(dslam: Run) -> None:
    result = dslam("degrade", "--list-faults")
    assert (result.code, result.err) == (0, "")
    told = " ".join(result.out.split())
    assert all(f"{fault.usage} {fault.meaning}" in told for fault in FAULTS.values())


def test_refusals(dslam: Run, tmp_path: Path) -> None:
    output = tmp_path / "out.mcap"
    degrade = ("degrade", SAMPLE, "-o", output)
    assert_refused(dslam(*degrade), "no fault was given", "--fault dropout")
    assert_refused(dslam(*degrade, "--seed", 3), "no fault was given")
    assert_refused(dslam(*degrade, "--fault", "dropout=1.5"), "dropout=1.5", "less than or equal to 1")
    assert_refused(dslam(*degrade, "--fault", "max_range=nan"), "max_range=nan", "not allowed")
    assert_refused(dslam(*degrade, "--fault", "field_of_view=wide"), "field_of_view")
    assert_refused(dslam(*degrade, "--fault", "dropout=0.1", "--seed", -1), "negative")
    assert_refused(dslam(*degrade, "--fault", "keep_label=car"), "'car'", "tree", "utility_pole")
    assert_refused(dslam(*degrade, "--fault", "heading_jmp"), "heading_jmp", "did you mean heading_jump")
    assert_refused(dslam(*degrade, "--fault", "heading_jump=much"), "'much'", "a valid number")
    assert_refused(dslam(*degrade, "--fault", "labels_unique=3"), "takes no value")
    assert_refused(dslam("degrade", tmp_path / "none.mcap", "-o", output, "--fault", "dropout=0.1"), "No such file")
    assert_refused(
        dslam("degrade", SAMPLE, "-o", tmp_path / "none" / "out.mcap", "--fault", "dropout=0.1"), "no folder"
    )
    assert not list(tmp_path.iterdir())


def test_the_input_is_never_overwritten(dslam: Run, tmp_path: Path) -> None:
    log = write_log(tmp_path / "log.mcap")
    before = log.read_bytes()
    assert_refused(dslam("degrade", log, "-o", log, "--fault", "dropout=0.1"), "is the input")
    assert log.read_bytes() == before


def test_several_topics_that_fit(dslam: Run, tmp_path: Path) -> None:
    log, output = write_log(tmp_path / "log.mcap", detections=("/left", "/right")), tmp_path / "out.mcap"
    assert_refused(
        dslam("degrade", log, "-o", output, "--fault", "dropout=1"), "/left, /right", "--topic detections=/left"
    )
    result = dslam("degrade", log, "-o", output, "--fault", "dropout=1", "--topic", "detections=/left", "--json")
    assert json.loads(result.out)["detections_before"] == 10


def test_a_log_without_detections(dslam: Run, tmp_path: Path) -> None:
    log = write_log(tmp_path / "log.mcap", detections=())
    assert_refused(
        dslam("degrade", log, "-o", tmp_path / "out.mcap", "--fault", "dropout=1"), "no topic gives detections"
    )
