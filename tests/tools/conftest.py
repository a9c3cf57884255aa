from pathlib import Path

import pytest

from tests.tools.runs import SAMPLE
from tools import cli


@pytest.fixture(scope="session")
def mapped(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The sample, replayed once."""
    output = tmp_path_factory.mktemp("mapped") / "map.mcap"
    assert cli.run(["replay", str(SAMPLE), "-o", str(output)]) == 0
    return output
