"""The wheel, built and installed as a user does."""

import subprocess
import sys
import sysconfig
import tarfile
import venv
from pathlib import Path

import pytest

from tests.tools.runs import ROOT, run_python


def build(kind: str, source: Path, folder: Path) -> Path:
    """By the setuptools of this environment, without network."""
    call = f"from setuptools import build_meta; print(build_meta.build_{kind}({str(folder)!r}))"
    result = run_python("-c", call, folder=source)
    assert result.code == 0, result.err[-2000:]
    return folder / result.out.splitlines()[-1]


@pytest.fixture(scope="session")
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


@pytest.fixture(scope="session")
def wheel(sdist: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Built from the source distribution, as pip does."""
    folder = tmp_path_factory.mktemp("wheel")
    with tarfile.open(sdist) as archive:
        archive.extractall(folder, filter="data")
    return build("wheel", folder / sdist.name.removesuffix(".tar.gz"), folder)


@pytest.fixture(scope="session")
def home(wheel: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A fresh environment with the wheel; its dependencies are those of this environment."""
    home = tmp_path_factory.mktemp("fresh")
    venv.create(home, with_pip=False)
    site = Path(sysconfig.get_path("purelib", vars={"base": str(home)}))
    pip = [sys.executable, *f"-m pip --python {home}/bin/python install".split()]
    subprocess.run([*pip, *["--quiet", "--no-deps", "--no-index", "--ignore-installed"], str(wheel)], check=True)
    here = [path for path in sys.path if path.endswith("site-packages")]
    (site / "dependencies.pth").write_text("\n".join(here), encoding="utf-8")
    for name in ("slam", "logs", "tools", "descriptors"):
        (home / "others" / name).mkdir(parents=True)
        (home / "others" / name / "__init__.py").write_text(f"NAME = {name!r}\n", encoding="utf-8")
    return home
