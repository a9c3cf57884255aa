"""Robots carried off while the odometry goes on."""

from __future__ import annotations

import pytest

from slam.common.config import Config, LocalizationConfig
from slam.common.errors import SimulationError
from tests.helpers.loop_drives import two_blocks
from tools.lab.relocalization.silent import NOTICED_WITHIN_M, benchmark_silent_kidnapping


@pytest.mark.slow
def test_kidnappings_are_noticed_and_nothing_else():
    result = benchmark_silent_kidnapping(two_blocks(), Config(), kidnaps=2)
    assert result["noticed_rate"] == 1.0
    assert result["false_alarms"] == 0
    assert result["median_m"] is not None
    assert 0.0 < result["median_m"] <= NOTICED_WITHIN_M


@pytest.mark.slow
def test_twin_who_takes_them_for_impossible_notices_none():
    config = Config(localization=LocalizationConfig(failures_per_km=1e-300))
    result = benchmark_silent_kidnapping(two_blocks(), config, kidnaps=1)
    assert (result["noticed_rate"], result["median_m"]) == (0.0, None)


def test_a_tour_that_is_too_short_is_refused():
    with pytest.raises(SimulationError, match="give one of at least 410 m"):
        benchmark_silent_kidnapping(two_blocks().shortened(300.0), Config(), kidnaps=1)
