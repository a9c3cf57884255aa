"""Landmarks of a prior map that are passed again and again and never seen."""

from __future__ import annotations

import numpy as np

from slam.object_map.missing_landmarks import MissingLandmarks

NONE = np.zeros(0, dtype=np.int64)


def test_what_was_passed_often_and_never_matched_is_missing():
    missing = MissingLandmarks()
    for _ in range(5):
        missing.add(np.array([9, 4, 7]), np.array([2]))
    assert missing.rows().tolist() == []
    missing.add(np.array([9, 4]), NONE)
    assert missing.rows().tolist() == [4, 9]


def test_what_was_matched_once_is_there():
    missing = MissingLandmarks()
    missing.add(np.array([4]), np.array([4]))
    for _ in range(6):
        missing.add(np.array([4]), NONE)
    assert missing.rows().tolist() == []
