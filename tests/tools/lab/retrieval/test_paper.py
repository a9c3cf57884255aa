"""The experiment of global localization: its measures are what they say, and its ceiling is one."""

from __future__ import annotations

import numpy as np
import pytest

from slam.common.arrays import FloatArray
from slam.common.config import Config
from slam.common.geometry import apply, invert, transform_from_xyz_yaw
from tests.helpers.long_street import start_of_street
from tools.lab.retrieval.labelled_map import LabelledMap
from tools.lab.retrieval.paper import NOISE_PER_M, fit_truth, localizer_config
from tools.lab.retrieval.paper_queries import SCENARIOS, LocalQuery, draw_queries

pytestmark = pytest.mark.slow

SELF, FEWER, NOISY = SCENARIOS


@pytest.fixture(scope="module")
def street() -> tuple[LabelledMap, FloatArray]:
    """The first third of the street."""
    return start_of_street(350)


@pytest.mark.parametrize("scenario", [SELF, FEWER], ids=lambda scenario: scenario.name)
def test_the_fit_to_the_truth_is_exact_without_noise(street, scenario):
    objects, tour = street
    for query in draw_queries(objects, tour, scenario, count=20, rng=np.random.default_rng(1)):
        np.testing.assert_allclose(fit_truth(objects, query, scenario), query.T_map_query_gt, atol=1e-9)


def test_the_fit_weighs_near_objects_more():
    T = transform_from_xyz_yaw(np.array([4.0, 5.0, 0.0]), 0.5)
    near = np.array([[2.0, 0.0, 0.0], [-1.0, 2.0, 0.0], [0.0, -2.0, 0.0]])
    positions = apply(T, np.vstack([near, [[25.0, 5.0, 0.0]]]))
    objects = LabelledMap(positions, np.zeros(4, np.int64), ("tree",))
    seen = apply(invert(T), positions)
    seen[3] += [2.0, 2.0, 0.0]
    fitted = fit_truth(objects, LocalQuery(seen, objects.labels, np.arange(4), T), NOISY)
    assert 0.0 < np.linalg.norm((fitted - T)[:2, 3]) < 0.2


def test_configuration_is_the_shipped_one_with_the_noise_of_the_queries():
    shipped = Config()
    for noisy in (False, True):
        config = localizer_config("gosmatch_vertex", noisy=noisy)
        assert config.localization == shipped.localization
        assert config.loop_closure == shipped.loop_closure.model_copy(update={"descriptor": "gosmatch_vertex"})
        assert np.sqrt(2.0) * config.calibration.objects.landmark_sigma_per_m == pytest.approx(NOISE_PER_M * noisy)
