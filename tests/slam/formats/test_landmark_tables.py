"""Tables of landmarks: names of classes in any script, and what stands in them."""

from __future__ import annotations

import csv
from pathlib import Path

import numpy as np
import pytest

from slam.formats.landmark_tables import write_csv
from tests.slam.evaluation.maps import object_map


@pytest.mark.parametrize("name", ["Bäume", "路灯", "a\u2028b", 'two\nlines, and "quotes"'])
def test_a_table_holds_any_name_of_a_class(tmp_path: Path, name: str) -> None:
    objects = object_map(("7",), np.array([[1.0, 2.0, 3.0]]), (name,))
    write_csv(tmp_path / "landmarks.csv", objects)
    with (tmp_path / "landmarks.csv").open(encoding="utf-8", newline="") as stream:
        (row,) = csv.DictReader(stream)
    assert row["label"] == name
