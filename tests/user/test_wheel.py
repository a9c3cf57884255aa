"""Wheel and source distribution: built, installed beside packages of our folders' names, and used."""

import tarfile
import zipfile
from pathlib import Path

import pytest

from tests.tools.runs import SAMPLE, run_python
from tests.user.installed import run

pytestmark = pytest.mark.slow

EXAMPLE = """
from dslam import Config, evaluate_log, landmark_table, read_map

evaluation = evaluate_log("map.mcap")
assert evaluation.estimate is not None
print(len(landmark_table(read_map("map.mcap"))["id"]), Config().keyframe.distance_m)
reveal_type(evaluation.estimate)
"""


def test_the_wheel_holds_one_package(wheel: Path) -> None:
    with zipfile.ZipFile(wheel) as archive:
        names = [name for name in archive.namelist() if ".dist-info/" not in name]
    assert {name.split("/")[0] for name in names} == {"dslam"}
    assert "dslam/py.typed" in names
    assert "dslam/logs/samples/short_drive.mcap" in names
    assert "dslam/descriptors/weights/descriptellation_lr.safetensors" in names
    assert not [name for name in names if "/tests/" in name]
    assert wheel.stat().st_size < 5e6


def test_the_source_distribution_holds_licence_and_build(sdist: Path) -> None:
    with tarfile.open(sdist) as archive:
        names = {name.split("/", 1)[-1] for name in archive.getnames()}
    assert {"LICENSE", "README.md", "pyproject.toml", "setup.py", "dslam.py", "slam/system.py"} <= names


def test_a_drive_is_mapped_and_evaluated_in_a_fresh_environment(home: Path) -> None:
    assert run(home, "dslam", "--version") == run(home, "python", "-m", "dslam", "--version")
    assert "replay uses" in run(home, "dslam", "info", SAMPLE)
    run(home, "dslam", "replay", SAMPLE, "-o", home / "map.mcap", "--picture", home / "map.png", "--verbose")
    assert "trajectory" in run(home, "dslam", "evaluate", "map.mcap", "--picture", home / "compared.png", "--json")
    everyone = (
        "import slam, logs, tools, descriptors, dslam; from dslam import replay; print(slam.NAME, replay.__module__)"
    )
    assert run(home, "python", "-c", everyone).split() == ["slam", "dslam.slam.replay"]


def test_the_library_is_typed(home: Path) -> None:
    example = home / "example.py"
    example.write_text(EXAMPLE, encoding="utf-8")
    options = f"-m mypy --strict --python-executable {home}/bin/python example.py".split()
    result = run_python(*options, folder=home)
    assert 'Revealed type is "dslam.slam.evaluation.metrics.trajectory.TrajectoryErrors"' in result.out
    assert result.code == 0, result.out
