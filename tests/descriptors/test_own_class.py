"""A descriptor of a user's own: the page's example, and what is refused."""

import re
import sys
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

from descriptors.errors import DescriptorError
from descriptors.index import VectorIndex
from descriptors.learned.networks import default_architecture
from descriptors.registry import make_descriptor, make_index
from descriptors.training.contrast import ContrastTraining
from descriptors.training.trainer import Recipe, train
from tests.descriptors.constellations import describe, found_again, gathered, scattered
from tests.helpers.trainings import short_trainings
from tests.tools.runs import text_of

EXAMPLES = re.findall(r"```python\n(.*?)```", text_of("docs/descriptors.md"), re.DOTALL)


@pytest.fixture
def mine(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Path]:
    """The current folder with ``mine.py`` as the page has it."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(sys, "path", [folder for folder in sys.path if folder])
    (tmp_path / "mine.py").write_text("\n\n".join(EXAMPLES))
    yield tmp_path
    sys.modules.pop("mine", None)


def described(name: str) -> np.ndarray:
    return describe(make_descriptor(name), *scattered(20, seed=3))


@pytest.mark.usefixtures("mine")
def test_example_of_the_page_is_found_in_the_current_folder_and_finds_objects() -> None:
    assert all(len(code.strip().splitlines()) <= 20 for code in EXAMPLES)
    matches = found_again(make_index("mine:Rings"), *scattered(60, seed=1))
    assert np.mean(matches.entries == np.arange(60)) > 0.9


@pytest.mark.parametrize(
    ("members", "message"),
    [
        ("radius_m = 20.0\n    def describe(self, c): return 1", "lacks name"),
        ("name = 'a'\n    radius_m = 20.0\n    def describe(self, c): return [0.0] * len(c)", r"shape \(20,\) for 20"),
        ("name = 'a'\n    radius_m = 20.0\n    def describe(self, c): return [[1.0]]", r"shape \(1, 1\) for 20"),
        (
            "name = 'a'\n    radius_m = 20.0\n    def describe(self, c): return [[float('nan')]] * len(c)",
            "0 is not finite",
        ),
        ("name = 'a'\n    radius_m = 20.0\n    def describe(self, c): return c.nothing", "AttributeError"),
        ("name = 'a'\n    radius_m = 'far'\n    def describe(self, c): return 1", "'far'; give metres"),
        ("name = 'a'\n    radius_m = 0.0\n    def describe(self, c): return 1", "above 0"),
    ],
)
def test_class_that_is_no_descriptor_is_refused_by_its_name(mine: Path, members: str, message: str) -> None:
    (mine / "mine.py").write_text(f"class Bad:\n    {members}\n")
    with pytest.raises(DescriptorError, match=rf"^mine:Bad: .*{message}"):
        described("mine:Bad")


def test_vectors_whose_length_changes_are_refused(mine: Path) -> None:
    (mine / "mine.py").write_text(
        "import numpy as np\n\nclass Bad:\n    name, radius_m = 'bad', 20.0\n"
        "    def describe(self, c): return np.zeros((len(c), len(c)))\n"
    )
    index = make_index("mine:Bad")
    assert isinstance(index, VectorIndex)
    index.add(gathered(*scattered(5, seed=1), radius_m=20.0))
    with pytest.raises(DescriptorError, match=r"mine:Bad: .* length 6, before of length 5"):
        index.add(gathered(*scattered(6, seed=1), radius_m=20.0))


@pytest.fixture(autouse=True)
def _short_trainings() -> Iterator[None]:
    with short_trainings():
        yield


def small_training() -> Recipe:
    return Recipe(ContrastTraining(architecture=default_architecture("mine:Net"), epochs=1, validation_maps=1))


def test_network_of_the_page_is_trained_and_its_weights_describe(mine: Path) -> None:
    train(small_training(), mine / "out", threads=1)
    vectors = described(str(mine / "out" / "weights.safetensors"))
    assert vectors.shape == (20, 32)
    np.testing.assert_allclose(np.linalg.norm(vectors, axis=1), 1.0, rtol=1e-5)


@pytest.mark.parametrize(
    ("body", "message"),
    [
        (
            "length = 4\n    def forward(self, p, l, m): return p.sum(dim=(1, 2))[:, None]",
            r"returns shape \(.*give \(.*, 4\)",
        ),
        ("length = 3\n    def forward(self, p, l, m): return p.sum(dim=1) / 0.0", "not finite"),
        ("length = 3\n    def forward(self, p, l, m): return p @ l", "fails"),
        ("def forward(self, p, l, m): return p", "no length"),
        ("weights = None\n    length = 3", "no weights"),
        ("pass\n\nNet = dict", "is not a torch.nn.Module"),
    ],
)
def test_network_that_gives_no_vectors_is_refused_by_its_name(mine: Path, body: str, message: str) -> None:
    weights = "" if "weights" in body else "        self.weights = nn.Linear(1, 1)\n"
    (mine / "mine.py").write_text(
        "from torch import nn\n\nclass Net(nn.Module):\n    def __init__(self):\n        super().__init__()\n"
        f"{weights}    {body}\n"
    )
    with pytest.raises(DescriptorError, match=rf"^mine:Net: .*{message}"):
        train(small_training(), mine / "out", threads=1)
