"""Parts of the method that a sweep switches off."""

import pkgutil
from pathlib import Path

import pytest

from slam.common.config import Config, load_config
from slam.sweeps import sweep
from slam.sweeps.mapped_drive import DriveTask, MappedDrive
from tests.tools.runs import SAMPLE, Run, assert_refused, assert_well
from tools.lab.drives import parts
from tools.lab.drives.parts import PARTS, map_without


@pytest.mark.parametrize("part", PARTS)
def test_settings_and_functions_of_each_part_exist(part: str, monkeypatch: pytest.MonkeyPatch) -> None:
    off = PARTS[part]
    assert (load_config(None, off.settings) != Config()) == bool(off.settings)
    assert off.settings or off.replaced

    def map_nothing(task: DriveTask) -> MappedDrive:
        replaced = [pkgutil.resolve_name(name) is value for name, value in PARTS[part].replaced.items()]
        return MappedDrive(log_s=float(all(replaced) if task.variant else any(replaced)))

    monkeypatch.setattr(parts, "map_drive", map_nothing)
    task = DriveTask(SAMPLE, Config(), variant=part)
    assert map_without(task).log_s == 1.0
    assert map_without(DriveTask(SAMPLE, Config())).log_s == 0.0


def test_sweep_compares_with_the_whole_method(dslam: Run, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    result = MappedDrive({"trajectory": {"ate_m": 0.5}}, ("optimised",))
    monkeypatch.setattr(sweep, "compute_all", lambda compute, tasks, jobs: ((task, result) for task in tasks))
    command = ("sweep", SAMPLE, "-o", tmp_path / "out", "--jobs", 1, "--seeds", 2)
    told = assert_well(dslam(*command, "--part", "calibration", "--part", "labels", "--markdown"))
    rows = [line.split(" | ")[:2] for line in told.out.splitlines() if line.startswith("| variant=")]
    assert rows == [[f"| variant={name} (2 runs)", "0.500 ± 0.000"] for name in ("", "calibration", "labels")]
    assert_refused(dslam(*command, "--part", "wheels"), "no 'wheels'", "calibration")
