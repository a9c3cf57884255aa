"""The tables name rules that are there."""

from __future__ import annotations

import pytest

from tests.mutants.mutant import ROOT, Mutant, read_mutants
from tests.mutants.trial import Verdict, run_tests

MUTANTS = read_mutants()


@pytest.mark.parametrize("mutant", MUTANTS, ids=lambda each: f"{each.module}: {each.rule}")
def test_a_mutant_is_a_change_of_one_place_that_compiles(mutant):
    compile(mutant.source(), mutant.file, "exec")
    assert mutant.original != mutant.mutated
    assert all((ROOT / each).exists() for each in mutant.tests)


def test_rules_have_names_of_their_own():
    names = [(each.file, each.rule) for each in MUTANTS]
    assert len(names) == len(set(names)) >= 90


@pytest.mark.slow
def test_a_rule_that_is_broken_is_noticed_and_one_that_is_not_is_not():
    tests = ("tests/slam/odometry/test_noise.py",)
    broken = Mutant("slam/odometry/noise.py", tests, "", "translation + config", "0.0 * translation + config")
    assert run_tests(tests, broken) is Verdict.CAUGHT
    assert run_tests(tests) is Verdict.SURVIVED
    missing = Mutant("slam/odometry/noise.py", tests, "", "import numpy as np", "import no_such_library as np")
    assert run_tests(tests, missing) is Verdict.BROKEN
