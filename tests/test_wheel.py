"""Wheel and source distribution: built, installed beside packages of our folders' names, and used."""

from __future__ import annotations

import re
import shutil
import subprocess
import sys
import sysconfig
import tarfile
import venv
import zipfile
from pathlib import Path

import pytest

pytestmark = pytest.mark.slow

ROOT = Path(__file__).resolve().parents[1]
SAMPLE = ROOT / "logs" / "samples" / "short_drive.mcap"
EXAMPLE = """
from dslam import Config, evaluate_log, landmark_table, read_map

evaluation = evaluate_log("map.mcap")
assert evaluation.estimate is not None
print(len(landmark_table(read_map("map.mcap"))["id"]), Config().keyframe.distance_m)
reveal_type(evaluation.estimate)
"""


def build(kind: str, source: Path, folder: Path) -> Path:
    """By the setuptools of this environment, without network."""
    call = f"from setuptools import build_meta; print(build_meta.build_{kind}({str(folder)!r}))"
    result = subprocess.run([sys.executable, "-c", call], cwd=source, capture_output=True, text=True)
    assert result.returncode == 0, result.stderr[-2000:]
    return folder / result.stdout.splitlines()[-1]


@pytest.fixture(scope="module")
def sdist(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The repository as git would export it, so that no leftovers of other builds get in."""
    folder = tmp_path_factory.mktemp("sdist")
    archive = subprocess.run(["git", "ls-files", "-z"], cwd=ROOT, capture_output=True, check=True).stdout
    checkout = folder / "checkout"
    for name in archive.decode().split("\0"):
        if name and (ROOT / name).is_file():
            (checkout / name).parent.mkdir(parents=True, exist_ok=True)
            (checkout / name).write_bytes((ROOT / name).read_bytes())
    return build("sdist", checkout, folder)


@pytest.fixture(scope="module")
def wheel(sdist: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Built from the source distribution, as pip does."""
    folder = tmp_path_factory.mktemp("wheel")
    with tarfile.open(sdist) as archive:
        archive.extractall(folder, filter="data")
    return build("wheel", folder / sdist.name.removesuffix(".tar.gz"), folder)


@pytest.fixture(scope="module")
def home(wheel: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A fresh environment with the wheel; its dependencies are those of this environment."""
    home = tmp_path_factory.mktemp("fresh")
    venv.create(home, with_pip=False)
    site = Path(sysconfig.get_path("purelib", vars={"base": str(home)}))
    pip = [
        sys.executable,
        "-m",
        "pip",
        "--python",
        str(home / "bin" / "python"),
        "install",
        "--quiet",
        "--no-deps",
        "--no-index",
    ]
    subprocess.run([*pip, "--ignore-installed", str(wheel)], check=True)
    (site / "dependencies.pth").write_text(sysconfig.get_path("purelib") + "\n", encoding="utf-8")
    for name in ("slam", "logs", "tools", "descriptors"):
        (home / "others" / name).mkdir(parents=True)
        (home / "others" / name / "__init__.py").write_text(f"NAME = {name!r}\n", encoding="utf-8")
    return home


def run(home: Path, *command: object, folder: Path | None = None) -> str:
    result = subprocess.run(
        [str(home / "bin" / str(command[0])), *map(str, command[1:])],
        cwd=folder or home,
        env={"PYTHONPATH": str(home / "others"), "PATH": "/usr/bin:/bin"},
        capture_output=True,
        text=True,
    )
    assert result.returncode == 0, result.stderr[-2000:]
    return result.stdout


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
    assert "trajectory" in run(home, "dslam", "evaluate", "map.mcap", "--html", home / "map.html", "--json")
    everyone = (
        "import slam, logs, tools, descriptors, dslam; from dslam import replay; print(slam.NAME, replay.__module__)"
    )
    assert run(home, "python", "-c", everyone).split() == ["slam", "dslam.slam.replay"]


PAGES = [ROOT / "README.md", *sorted((ROOT / "docs").glob("*.md"))]
CODE = {
    f"{page.stem}-{number}": block
    for page in PAGES
    for number, block in enumerate(re.findall(r"```python\n(.*?)```", page.read_text(encoding="utf-8"), re.DOTALL))
}


@pytest.fixture(scope="module")
def drives(home: Path) -> Path:
    """A folder with a drive, its result and its map, by the names of the pages."""
    folder = home / "drives"
    folder.mkdir()
    for name in ("drive", "monday", "tuesday"):
        shutil.copy(SAMPLE, folder / f"{name}.mcap")
    run(home, "dslam", "replay", SAMPLE, "-o", folder / "map.mcap", "--save-map", folder / "saved.mcap")
    return folder


@pytest.mark.parametrize("name", CODE)
def test_code_of_the_documents_runs(home: Path, drives: Path, tmp_path: Path, name: str) -> None:
    shutil.copytree(drives, tmp_path / "work")
    (tmp_path / "work" / "example.py").write_text(CODE[name], encoding="utf-8")
    printed = run(home, "python", "example.py", folder=tmp_path / "work")
    assert ("[[" in printed) == ("ScanLocalizer" in CODE[name])  # it is found, and its pose printed


def test_the_library_is_typed(home: Path) -> None:
    example = home / "example.py"
    example.write_text(EXAMPLE, encoding="utf-8")
    command = [
        sys.executable,
        "-m",
        "mypy",
        "--strict",
        "--python-executable",
        str(home / "bin" / "python"),
        "example.py",
    ]
    result = subprocess.run(command, cwd=home, capture_output=True, text=True)
    assert 'Revealed type is "dslam.slam.evaluation.metrics.trajectory.TrajectoryErrors"' in result.stdout
    assert result.returncode == 0, result.stdout
