"""Every name stands for a descriptor and an index that keep the same rules."""

import sys

import numpy as np
import pytest

from descriptors.errors import DescriptorError
from descriptors.registry import DESCRIPTOR_NAMES, make_descriptor, make_index
from tests.descriptors.constellations import describe, found_again, scattered
from tests.tools.runs import loaded_by

# Of these, the vectors of unlike objects may be as near as those of like ones.
VAGUE = ("random",)

VECTORS = tuple(name for name in DESCRIPTOR_NAMES if name != "descriptellation_lr")
every_name = pytest.mark.parametrize("name", VECTORS)


@every_name
def test_index_finds_the_objects_of_a_scattered_map_again(name):
    positions, labels = scattered(60, seed=1)
    matches = found_again(make_index(name), positions, labels)
    np.testing.assert_array_equal(matches.queries, np.arange(60))
    np.testing.assert_array_equal(labels[matches.entries], labels)
    if name not in VAGUE:
        assert np.mean(matches.entries == np.arange(60)) > 0.9


@every_name
def test_descriptor_has_its_name_and_finite_vectors_of_one_length(name):
    descriptor = make_descriptor(name)
    assert descriptor.name == name
    positions, labels = scattered(30, seed=2)
    positions[:2, 0] += [1000.0, 2000.0]
    positions[2:4] = positions[4:6]  # at one place
    vectors, lonely = describe(descriptor, positions, labels), describe(descriptor, positions[:1], labels[:1])
    nobody = describe(descriptor, positions[:0], labels[:0])
    assert len(vectors) == 30
    assert vectors.shape[1:] == lonely.shape[1:] == nobody.shape[1:]
    assert np.isfinite(vectors).all()
    assert vectors.dtype == lonely.dtype == nobody.dtype == np.float32


@pytest.mark.parametrize(
    ("name", "message"),
    [
        ("no_such_module:Own", "ModuleNotFoundError"),
        ("tests.descriptors.test_registry:Other", "AttributeError"),
        ("builtins:dict", "lacks name, radius_m, describe"),
        ("no/such.safetensors", "No such file"),
        ("rings", f"unknown descriptor 'rings'; choose one of {', '.join(DESCRIPTOR_NAMES)}"),
    ],
)
def test_unknown_descriptor_is_refused_with_the_reason(name, message):
    for make in (make_descriptor, make_index):
        with pytest.raises(DescriptorError, match=message):
            make(name)


def test_random_vectors_differ_in_each_call_and_repeat_in_each_run():
    positions, labels = scattered(10, seed=5)
    first, second = make_descriptor("random"), make_descriptor("random")
    vectors = [describe(first, positions, labels) for _ in range(2)]
    assert np.abs(vectors[0] - vectors[1]).min() > 0.0
    np.testing.assert_array_equal([describe(second, positions, labels) for _ in range(2)], vectors)


def test_descriptors_without_a_network_do_not_load_torch():
    """It takes seconds to load."""
    code = "from descriptors.registry import *; [make_index(name) for name in DESCRIPTOR_NAMES if name != PAPER]"
    pairs = "descriptors.descriptellation_lr.pair_index"
    assert loaded_by(code, f"torch {pairs}") == pairs


def test_make_descriptor_names_the_extra_that_a_network_needs(monkeypatch: pytest.MonkeyPatch) -> None:
    for module in [name for name in sys.modules if name.startswith("descriptors.learned.")]:
        monkeypatch.delitem(sys.modules, module)
    monkeypatch.setitem(sys.modules, "torch", None)
    with pytest.raises(DescriptorError, match=r"network and needs torch: pip install '.*\[learn\]'"):
        make_descriptor("descriptellation")
    make_descriptor("descriptellation_lr")
