"""Architectures: from their fields and back, and the labels a network has rows for."""

from __future__ import annotations

from dataclasses import asdict, replace

import numpy as np
import pytest

from descriptors.descriptellation.network import DescriptellationArchitecture
from descriptors.errors import DescriptorError
from descriptors.learned.architectures import ARCHITECTURES, check_labels, make_architecture, make_network


def test_labels_that_a_network_has_no_row_for_are_refused_with_both_numbers_and_a_remedy():
    check_labels(np.array([[0, 63]]), 64)
    check_labels(np.zeros((0, 3), dtype=np.int64), 64)
    with pytest.raises(DescriptorError, match=r"label 64 .* 64 classes.*larger vocabulary_size"):
        check_labels(np.array([[0, 64]]), 64)
    with pytest.raises(DescriptorError, match="label -1"):
        check_labels(np.array([[0, -1]]), 64)


@pytest.mark.parametrize("name", sorted(ARCHITECTURES))
def test_architectures_survive_their_fields(name):
    kind, network_class = ARCHITECTURES[name]
    architecture = replace(kind(), length=16, vocabulary_size=5)
    again = make_architecture(asdict(architecture))
    assert again == architecture
    made = make_network(again)
    assert isinstance(made, network_class)
    assert made.architecture == architecture


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"name": "net"}, r"'net'.*descriptellation"),
        ({"depth": 3}, r"unknown fields \['depth'\]"),
        ({"layers": "14"}, r"layers = '14'"),
        ({"input": "smell"}, r"input = 'smell'"),
    ],
)
def test_fields_that_make_no_architecture_are_refused_by_name(change, message):
    with pytest.raises(DescriptorError, match=message):
        make_architecture(asdict(DescriptellationArchitecture()) | change)


def test_fields_that_are_missing_are_refused_by_name():
    with pytest.raises(DescriptorError, match=r"no fields \['layers'\]"):
        make_architecture({key: v for key, v in asdict(DescriptellationArchitecture()).items() if key != "layers"})
