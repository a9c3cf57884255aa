"""dslam degrade, as it is typed."""

from pathlib import Path

from slam.simulation.faults.registry import FAULTS
from tests.helpers.short_drives import metadata_of
from tests.tools.runs import SAMPLE, Run, assert_refused, assert_well, write_drive

DETECTIONS = 3313


def test_faults_are_applied_in_their_order_and_recorded(dslam: Run, tmp_path: Path) -> None:
    output = tmp_path / "out.mcap"
    faults = ["position_noise=0.2", "dropout=0.3", "keep_label=tree:bench", "messages_twice", "false_positives=1.5"]
    typed = [part for fault in faults for part in ("--fault", fault)]
    report = assert_well(dslam("degrade", SAMPLE, "-o", output, *typed, "--seed", 3, "--json")).json
    assert report["faults"] == faults
    assert 0 < report["detections"] < report["detections_before"] == DETECTIONS
    told = metadata_of(output)["faults"]
    assert (told["faults"], told["seed"]) == (" ".join(faults), "3")


def test_list_has_every_fault_with_its_meaning(dslam: Run) -> None:
    told = assert_well(dslam("degrade", "--list-faults")).text
    assert all(f"{fault.name} {fault.meaning}" in told for fault in FAULTS.values())


def test_refusals(dslam: Run, tmp_path: Path) -> None:
    """Values that are not allowed are tested in tests/slam/simulation/faults."""
    log, output = write_drive(tmp_path / "log.mcap", detections=("/left", "/right")), tmp_path / "out.mcap"
    degrade = ("degrade", SAMPLE, "-o", output)
    assert_refused(dslam(*degrade), "no fault was given", "--fault dropout")
    several = ("degrade", log, "-o", output, "--fault", "dropout=1")
    assert_refused(dslam(*several), "/left, /right", "--topic detections=/left")
    assert_refused(dslam(*several[:3], log, *several[4:]), "is the input")
    assert not output.exists()
    assert dslam(*several, "--topic", "detections=/left", "--json").json["detections_before"] == 30
