"""How the wheel is built: everything in it stands below the one package ``dslam``.

The folders of the repository are imported as ``slam``, ``descriptors``, ``logs`` and ``tools``, names that other
packages have too. Setuptools can place ``slam`` at ``dslam.slam``, but leaves the imports in its files as they are;
they are changed here. An editable install imports the folders as they are.
"""

import ast
import re
import shutil
from pathlib import Path

from setuptools import setup
from setuptools.command.build_py import build_py

PACKAGES = ("descriptors", "logs", "slam", "tools")
START_COMMAND = '"""``python -m dslam``."""\n\nfrom dslam import main\n\nmain()\n'


class BuildBelowOnePackage(build_py):
    """``slam/system.py`` becomes ``dslam/slam/system.py``, ``dslam.py`` becomes ``dslam/__init__.py``."""

    def run(self) -> None:
        """Copy the files, then move them and change their imports."""
        if self.editable_mode:
            super().run()
            return
        built = Path(self.build_lib)
        shutil.rmtree(built, ignore_errors=True)
        super().run()
        package = built / "dslam"
        package.mkdir()
        (built / "dslam.py").rename(package / "__init__.py")
        (package / "__main__.py").write_text(START_COMMAND, encoding="utf-8")
        (package / "py.typed").touch()
        for name in PACKAGES:
            (built / name).rename(package / name)
        for path in package.rglob("*.py*"):
            if path.suffix in (".py", ".pyi"):
                path.write_text(below_dslam(path.read_text(encoding="utf-8"), str(path)), encoding="utf-8")


def below_dslam(source: str, path: str) -> str:
    """The source with its absolute imports of :data:`PACKAGES` changed to imports from ``dslam``.

    Raises:
        ValueError: ``import slam.x`` without ``as``, which would bind another name.
    """
    lines = source.splitlines(keepends=True)
    for node in ast.walk(ast.parse(source, path)):
        if isinstance(node, ast.ImportFrom) and node.level == 0 and _is_ours(node.module):
            lines[node.lineno - 1] = re.sub(r"\bfrom (?=\w)", "from dslam.", lines[node.lineno - 1], count=1)
        elif isinstance(node, ast.Import) and any(_is_ours(alias.name) for alias in node.names):
            raise ValueError(f"{path}:{node.lineno}: write 'from package import module', which can be built")
    return "".join(lines)


def _is_ours(module: str | None) -> bool:
    return (module or "").partition(".")[0] in PACKAGES


if __name__ == "__main__":
    setup(cmdclass={"build_py": BuildBelowOnePackage})
