from pathlib import Path

import pytest

from tests.tools.runs import SAMPLE, run_well


@pytest.fixture(scope="session")
def mapped(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The sample, replayed once."""
    output = tmp_path_factory.mktemp("mapped") / "map.mcap"
    run_well("replay", SAMPLE, "-o", output)
    return output
