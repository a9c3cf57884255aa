import pytest

from slam.backend.factor_graph import FactorGraph
from tests.slam.backend.graphs import build, noisy_edges, sightings


@pytest.fixture
def graph() -> FactorGraph:
    """As a drive builds it, with noise."""
    return build(noisy_edges(), sightings())
