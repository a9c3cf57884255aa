"""No library with a licence that would pass on to this package is imported."""

import sys
from importlib.metadata import packages_distributions

import pytest
from packaging.utils import canonicalize_name

from tests.supply_chain.dependencies import find_dependencies, is_permitted, licence_of
from tests.test_imports import OURS, imports, sources
from tests.tools.runs import ROOT

DEPENDENCIES = find_dependencies()
OWN = {*OURS, "dslam", "tests"}


def imported_names() -> dict[str, str]:
    """The top-level modules that any file imports, with one such file."""
    paths = sources(*OURS, "tests", "docs")
    return {name.split(".")[0]: str(path.relative_to(ROOT)) for path in paths for name in imports(path)}


def test_the_dependencies_are_found_down_to_those_of_others():
    assert {"numpy", "gtsam", "torch", "typer", "click"} <= DEPENDENCIES.keys()
    assert "ruff" not in DEPENDENCIES


@pytest.mark.parametrize("name", sorted(DEPENDENCIES))
def test_every_dependency_has_a_licence_that_permits_its_use(name):
    assert is_permitted(licence_of(DEPENDENCIES[name])), licence_of(DEPENDENCIES[name])


@pytest.mark.slow
def test_nothing_under_the_gpl_is_imported_not_even_by_tests():
    owners = packages_distributions()
    for module, file in imported_names().items():
        if module in OWN or module in sys.stdlib_module_names:
            continue
        for name in {canonicalize_name(owner) for owner in owners.get(module, ())}:
            found = find_dependencies(name, ()).get(name)
            assert found is None or is_permitted(licence_of(found)), f"{file} imports {module}: {licence_of(found)}"


@pytest.mark.parametrize(("licence", "is_fine"), [
    ("GPL-3.0-or-later", False), ("GNU General Public License v3 (GPLv3)", False), ("", False),
    ("LGPL-2.1", True),
    ("MIT OR GPL-2.0-only", True), ("GPL-2.0-only WITH GCC-exception-3.1", True),
])  # fmt: skip
def test_which_licences_are_permitted(licence, is_fine):
    assert is_permitted(licence) is is_fine
