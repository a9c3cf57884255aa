"""Tables of landmarks: names of classes in any script, and what stands in them."""

import csv
import json
from pathlib import Path

import numpy as np
import pytest

from slam.common.georeference import Georeference
from slam.formats.landmark_tables import write_csv, write_points
from tests.slam.evaluation.maps import object_map


@pytest.mark.parametrize("name", ["Bäume", "路灯", "a\u2028b", 'two\nlines, and "quotes"'])
def test_a_table_holds_any_name_of_a_class(tmp_path: Path, name: str) -> None:
    objects = object_map(("7",), np.array([[1.0, 2.0, 3.0]]), (name,))
    write_csv(tmp_path / "landmarks.csv", objects)
    with (tmp_path / "landmarks.csv").open(encoding="utf-8", newline="") as stream:
        (row,) = csv.DictReader(stream)
    assert row["label"] == name


@pytest.mark.parametrize(("origin", "place"), [(Georeference(60.0, 25.0), [25.0, 60.0]), (None, [1.0, 2.0])])
def test_write_points_says_where_places_on_earth_are_unknown(
    tmp_path: Path, origin: Georeference | None, place: list[float]
) -> None:
    write_points(tmp_path / "points.geojson", np.array([[1.0, 2.0, 3.0]]), [{"kind": "gone"}], origin)
    collection = json.loads((tmp_path / "points.geojson").read_text())
    assert collection.get("coordinates") == (None if origin else "metres in the frame of the map")
    (feature,) = collection["features"]
    assert feature["properties"] == {"kind": "gone"}
    np.testing.assert_allclose(feature["geometry"]["coordinates"], [*place, 3.0], atol=1e-4)
