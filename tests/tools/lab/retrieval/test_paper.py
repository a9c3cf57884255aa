"""The experiment of global localization."""

import numpy as np
import pytest

from slam.common.config import Config
from tools.lab.retrieval.paper import NOISE_PER_M, localizer_config


def test_configuration_is_the_shipped_one_with_the_noise_of_the_queries():
    shipped = Config()
    for noisy in (False, True):
        config = localizer_config("gosmatch_vertex", noisy=noisy)
        assert config.localization == shipped.localization
        assert config.loop_closure == shipped.loop_closure.model_copy(update={"descriptor": "gosmatch_vertex"})
        assert np.sqrt(2.0) * config.calibration.objects.landmark_sigma_per_m == pytest.approx(NOISE_PER_M * noisy)
