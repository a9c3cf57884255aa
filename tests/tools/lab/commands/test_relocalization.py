"""dslam benchmark relocalization, as it is typed."""

from pathlib import Path

import pytest

from tests.tools.lab.commands.test_descriptors import write_world
from tests.tools.runs import Run, assert_refused, assert_well

SHARES = ("success_rate", "late_rate", "false_relocalization_rate", "not_found_rate")


@pytest.mark.slow
def test_json_has_every_figure(dslam: Run, tmp_path: Path) -> None:
    log, files = tmp_path / "drive.mcap", write_world(tmp_path)
    assert dslam("simulate", log, *files).code == 0
    assert dslam("import", "map", tmp_path / "map.mcap", "--file", files[1], "--origin", "60,25").code == 0
    more = ("--map", tmp_path / "map.mcap", "--kidnaps", 2, "--json")
    told = assert_well(dslam("benchmark", "relocalization", "--log", log, *more)).json
    assert (told["drive"], len(told["outcomes"])) == ("drive", 2)
    assert sum(told["everywhere"][share] for share in SHARES) == pytest.approx(1.0)
    assert told["everywhere"]["kidnaps"] == 2
    assert "search ms" in dslam("benchmark", "relocalization", "--log", log, *more[:-1]).out


@pytest.mark.parametrize(
    ("options", "told"),
    [
        ((), "--map-until and --map"),
        (("--map-until", 3, "--map", "m.mcap"), "--map-until and --map"),
        (("--map-until", 9), "drive.mcap"),
    ],
)
def test_wrong_options_are_refused(dslam: Run, tmp_path: Path, options: tuple[object, ...], told: str) -> None:
    assert_refused(dslam("benchmark", "relocalization", "--log", tmp_path / "drive.mcap", *options), told)
