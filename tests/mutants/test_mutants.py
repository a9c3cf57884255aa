"""Mutants are sampled with a seed, and tests notice them."""

from __future__ import annotations

import pytest

pytest.importorskip("cosmic_ray")

from tests.mutants.mutant import Mutant, sample_mutants
from tests.mutants.trial import Verdict, copy_repository, run_tests


def test_sample_depends_on_the_seed_alone():
    sample = sample_mutants(5, seed=1, folders=["odometry"])
    assert sample == sample_mutants(5, seed=1, folders=["odometry"])
    assert len(set(sample)) == 5
    assert sample != sample_mutants(5, seed=2, folders=["odometry"])
    for mutant in sample:
        compile(mutant.source(), mutant.file, "exec")
        assert mutant.tests


@pytest.mark.slow
def test_tests_notice_a_broken_rule_and_no_intact_one(tmp_path):
    repository = copy_repository(tmp_path)
    mutant = Mutant("slam/odometry/noise.py", "core/ReplaceBinaryOperator_Add_Sub", 0)
    assert run_tests(repository, mutant.tests[:1]) is Verdict.SURVIVED
    assert run_tests(repository, mutant.tests[:1], mutant) is Verdict.CAUGHT
