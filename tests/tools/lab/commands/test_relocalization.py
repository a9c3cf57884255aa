"""dslam benchmark relocalization, as it is typed."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from tests.tools.runs import Run, assert_refused

SHARES = ("success_rate", "late_rate", "false_relocalization_rate", "not_found_rate")


@pytest.mark.slow
def test_json_has_every_figure(dslam: Run, tmp_path: Path) -> None:
    log, table = tmp_path / "drive.mcap", tmp_path / "objects.csv"
    table.write_text("x_m,y_m,z_m,class\n" + "".join(f"{x},{y},0,{c}\n" for x, y, c in _objects()))
    (tmp_path / "tour.csv").write_text("x_m,y_m\n0,0\n100,0\n")
    assert dslam("simulate", log, "--objects", table, "--trajectory", tmp_path / "tour.csv").code == 0
    assert dslam("import", "map", tmp_path / "map.mcap", "--file", table, "--origin", "60,25").code == 0
    more = ("--map", tmp_path / "map.mcap", "--kidnaps", 2, "--json")
    result = dslam("benchmark", "relocalization", "--log", log, *more)
    assert (result.code, result.err) == (0, "")
    told = json.loads(result.out)
    assert (told["drive"], len(told["outcomes"])) == ("drive", 2)
    assert sum(told["everywhere"][share] for share in SHARES) == pytest.approx(1.0)
    assert told["everywhere"]["kidnaps"] == 2
    assert "search ms" in dslam("benchmark", "relocalization", "--log", log, *more[:-1]).out


def _objects() -> list[tuple[float, float, str]]:
    """Objects beside a street, of three classes in no regular order."""
    return [(2.5 * i, 5.0 + i * i % 7 - 12.0 * (i % 2), ("tree", "lamp", "bench")[(7 * i // 3) % 3]) for i in range(40)]


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
