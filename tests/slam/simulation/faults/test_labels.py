from __future__ import annotations

from collections import Counter

from tests.slam.simulation.faults.streams import COUNT, LABELS, drive, faulty, labels

HALF = 50


def test_random_labels_are_those_of_the_log() -> None:
    found = Counter(label for scan in labels(faulty("labels_random")) for label in scan)
    assert set(found) == set(LABELS)
    assert min(found.values()) > 4 * COUNT / 3 * 0.7


def test_each_detection_has_a_label_of_its_own() -> None:
    found = [label for scan in labels(faulty("labels_unique")) for label in scan]
    assert len(set(found)) == len(found) == 4 * COUNT


def test_one_class() -> None:
    assert len({label for scan in labels(faulty("labels_one_class")) for label in scan}) == 1


def test_the_case_changes_at_half_time() -> None:
    found = labels(faulty("labels_case"))
    assert found[:HALF] == labels(drive())[:HALF]
    assert set(found[HALF:]) == {tuple(label.upper() for label in LABELS)}


def test_labels_are_permuted_at_half_time() -> None:
    found = labels(faulty("labels_permuted"))
    assert found[:HALF] == labels(drive())[:HALF]
    (after,) = set(found[HALF:])
    assert set(after) == set(LABELS)
    assert after[0] == after[1]  # both trees
    assert all(a != b for a, b in zip(after, LABELS, strict=True))
