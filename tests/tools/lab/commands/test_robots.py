"""dslam benchmark robots, as it is typed."""

from pathlib import Path

import pytest

from slam.sweeps.mapped_drive import MappedDrive
from tests.tools.runs import Run
from tools.lab.commands import robots

COUNTERS = {"odometry_used": 5, "landmarks_confirmed": 37, "odometry_breaks": 2, "closures_accepted": 3}
EVALUATION = {
    "counters": COUNTERS,
    "trajectory": {"odometry_ate_m": 1.3371, "ate_m": 0.0312},
    "associations": {"precision": 0.6175},
    "closures": {"accepted_count": 3, "precision": 1.0, "independent_count": 3, "largest_false_share": 0.632},
}


@pytest.fixture
def data(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Two drives, of which the first fails; nothing is mapped."""
    for name in ("good", "bad/one"):
        (tmp_path / "data" / name).mkdir(parents=True)
        (tmp_path / "data" / name / "odometry.tum").touch()
    runs = {
        "bad/one": MappedDrive(error="line 1 | broken"),
        "good": MappedDrive(EVALUATION, ("optimised",), 100.0, 4.0, 4.0, 250_000_000),
    }
    monkeypatch.setattr(
        robots, "map_robot", lambda drive, config: runs[drive.relative_to(tmp_path / "data").as_posix()]
    )
    return tmp_path / "data"


def test_the_table_tells_figures_warnings_and_failures(dslam: Run, data: Path) -> None:
    result = dslam("benchmark", "robots", data)
    assert result.code == 0
    assert result.err.splitlines() == ["1 of 2: bad/one, failed: line 1 | broken", "2 of 2: good, 4 s"]
    rows = {line.split()[0]: line.split()[1:] for line in result.out.splitlines() if line}
    assert set(rows["bad/one"]) == {"–"}
    figures = ["1.337", "0.031", "37", "61.8", "3", "100.0", "3:", "63", "–", "25.0", "0.25"]
    assert rows["good"] == figures
    assert "good: odometry breaks 2" in result.out
    assert "bad/one: line 1 | broken" in result.out
    assert all(len(line) <= 120 for line in result.out.splitlines())


def test_json_has_every_figure(dslam: Run, data: Path) -> None:
    bad, good = dslam("benchmark", "robots", data, "--json").json["drives"]
    assert (bad["error"], bad["notes"]) == ("line 1 | broken", ["line 1 | broken"])
    assert good["notes"] == ["odometry breaks 2"]
    assert good["evaluation"]["associations"]["precision"] == 0.6175
