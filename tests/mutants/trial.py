"""Runs tests in a forked child in which one module has another source."""

from __future__ import annotations

import contextlib
import importlib.abc
import importlib.util
import os
import resource
import sys
from collections.abc import Sequence
from enum import Enum
from importlib.machinery import ModuleSpec
from types import CodeType, ModuleType
from typing import NoReturn

from tests.mutants.mutant import ROOT, Mutant

_SECONDS, _BYTES = 120, 6_000_000_000
_LIBRARIES = ("pytest", "numpy", "scipy.spatial.transform", "scipy.sparse.csgraph", "scipy.optimize", "scipy.stats",
              "gtsam", "hypothesis", "pydantic", "rosbags.typesys", "mcap.reader", "logs.reader")  # fmt: skip


class Verdict(Enum):
    """What tests said; ``BROKEN``: they did not run, so that the mutant tells nothing."""

    CAUGHT = "caught"
    SURVIVED = "survived"
    BROKEN = "does not run"


def import_libraries() -> None:
    """Import what all children need and no mutant changes."""
    for name in _LIBRARIES:
        importlib.import_module(name)


def run_tests(tests: Sequence[str], mutant: Mutant | None = None) -> Verdict:
    """Run tests that are not slow, up to the first that fails.

    One that takes too long or too much memory fails.
    """
    child = os.fork()
    if child == 0:
        _be_the_child(tests, mutant)
    code = os.waitstatus_to_exitcode(os.waitpid(child, 0)[1])
    if code == 0:
        return Verdict.SURVIVED
    return Verdict.CAUGHT if code == 1 or code < 0 else Verdict.BROKEN


def _be_the_child(tests: Sequence[str], mutant: Mutant | None) -> NoReturn:
    code = 3
    with contextlib.suppress(BaseException):
        resource.setrlimit(resource.RLIMIT_CPU, (_SECONDS, _SECONDS))
        resource.setrlimit(resource.RLIMIT_AS, (_BYTES, _BYTES))
        for descriptor in (1, 2):
            os.dup2(os.open(os.devnull, os.O_WRONLY), descriptor)
        os.chdir(ROOT)
        _forget_project()
        if mutant is not None:
            sys.meta_path.insert(0, _Finder(mutant))
        os.environ["PYTEST_DISABLE_PLUGIN_AUTOLOAD"] = "1"
        import pytest

        code = int(pytest.main(["-q", "-x", "-p", "no:cacheprovider", "-m", "not slow", *tests]))
    os._exit(code)


def _forget_project() -> None:
    """Modules that are imported already would not be looked for."""
    for name in list(sys.modules):
        if name.split(".")[0] in ("slam", "tools", "tests") and not name.startswith("tests.mutants"):
            del sys.modules[name]


class _Finder(importlib.abc.MetaPathFinder, importlib.abc.InspectLoader):
    """Finds and loads the module of a mutant."""

    def __init__(self, mutant: Mutant) -> None:
        self._mutant = mutant

    def find_spec(self, fullname: str, path: object, target: ModuleType | None = None) -> ModuleSpec | None:
        if fullname != self._mutant.module:
            return None
        return importlib.util.spec_from_loader(fullname, self, origin=str(ROOT / self._mutant.file))

    def get_source(self, fullname: str) -> str:
        return self._mutant.source()

    def get_code(self, fullname: str) -> CodeType:
        return compile(self._mutant.source(), str(ROOT / self._mutant.file), "exec")
