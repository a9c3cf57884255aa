"""Maps of open data: tables, GeoJSON and OpenStreetMap, and what is wrong with them in one line."""

import gzip
import json
from pathlib import Path

import numpy as np
import pytest

from logs.errors import DatasetError
from logs.importers.maps.geojson import read_geojson
from logs.importers.maps.map_objects import MapObjects
from logs.importers.maps.object_table import read_object_table
from logs.importers.maps.osm import read_osm

OSM = """<?xml version="1.0"?>
<osm version="0.6">
 <node id="1" lat="60.1" lon="24.9" version="1"><tag k="natural" v="tree"/></node>
 <node id="2" lat="60.2" lon="24.8" version="1"><tag k="highway" v="street_lamp"/><tag k="ref" v="7"/></node>
 <node id="3" lat="60.3" lon="24.7" version="1"><tag k="highway" v="crossing"/></node>
 <node id="4" lat="60.4" lon="24.6" version="1"/>
 <node id="5" lat="60.5" lon="24.5" version="1"><tag k="traffic_sign" v="city_limit"/></node>
</osm>
"""


def feature(longitude: float, latitude: float, **properties: str) -> dict[str, object]:
    return {
        "type": "Feature",
        "geometry": {"type": "Point", "coordinates": [longitude, latitude]},
        "properties": properties,
    }


def geojson(path: Path, *features: object, **more: object) -> Path:
    path.write_text(json.dumps({"type": "FeatureCollection", "features": features, **more}))
    return path


def table(folder: Path, text: str) -> MapObjects:
    path = folder / "objects.csv"
    path.write_text(text)
    return read_object_table(path)


def test_table_of_metres_with_classes_and_ids(tmp_path: Path) -> None:
    path = tmp_path / "objects.csv.gz"
    path.write_bytes(gzip.compress(b"x_m,y_m,z_m,class,id\n1.5,-2,0.5,pole,a\n3,4,,,b\n"))
    objects = read_object_table(path)
    np.testing.assert_array_equal(objects.positions, [[1.5, -2.0, 0.5], [3.0, 4.0, 0.0]])
    assert (objects.labels, objects.ids, objects.is_geodetic) == (("pole", "object"), ("a", "b"), False)


def test_table_of_names_that_repeat_and_of_unknown_ids(tmp_path: Path) -> None:
    objects = table(tmp_path, "easting,northing,name\n1,2,bench\n3,4,bench\n5,6,\n")
    np.testing.assert_array_equal(objects.positions[:, :2], [[1, 2], [3, 4], [5, 6]])
    assert (objects.labels, objects.ids) == (("bench", "bench", "object"), ("bench", "bench#1", "line 4"))
    assert table(tmp_path, "x,y,id\n1,2,\n3,4,\n").ids == ("line 2", "line 3")


def test_table_of_degrees_by_the_names_of_its_columns(tmp_path: Path) -> None:
    objects = table(tmp_path, "Longitude;Latitude;Species\n24.9;60.1;oak\n")
    np.testing.assert_array_equal(objects.positions, [[60.1, 24.9, 0.0]])
    assert (objects.labels, objects.is_geodetic) == (("oak",), True)


@pytest.mark.parametrize(
    ("text", "fault"),
    [
        ("x_m,class\n1,pole\n", "no column for y"),
        ("lat,lon\n400,24\n", "these are metres"),
        ("lat,lon\n24,160\n-30,170\n100,60\n", "not degrees"),
        ("lat,lon\n160.1,24.9\n", "they are swapped"),
    ],
)
def test_read_object_table_refuses(tmp_path: Path, text: str, fault: str) -> None:
    with pytest.raises(DatasetError, match=fault):
        table(tmp_path, text)


def test_geojson_of_points_with_their_class(tmp_path: Path) -> None:
    line = {"type": "Feature", "geometry": {"type": "LineString", "coordinates": []}, "properties": None}
    path = geojson(tmp_path / "a.geojson", feature(24.9, 60.1, Class="tree"), line, feature(24.8, 60.2))
    objects = read_geojson(path)
    np.testing.assert_array_equal(objects.positions, [[60.1, 24.9, 0.0], [60.2, 24.8, 0.0]])
    assert objects.labels == ("tree", "object")
    assert objects.notes == ("1 features that are not points were ignored (1 LineString)",)


def test_geojson_of_areas_alone_holds_no_objects(tmp_path: Path) -> None:
    area = {"type": "Feature", "geometry": {"type": "Polygon", "coordinates": []}, "properties": {}}
    with pytest.raises(DatasetError, match=r"none of its features is a point \(2 Polygon, 1 without geometry\)"):
        read_geojson(geojson(tmp_path / "a.geojson", area, area, {"type": "Feature", "geometry": None}))


def test_read_geojson_refuses(tmp_path: Path) -> None:
    for fault, *features in (
        (r"latitude 6\.6e\+06.*these are metres", feature(385000.0, 6.6e6)),
        ("they are swapped", feature(34.0, -118.2)),
        ("holds no objects",),
        (r"features\.0\.geometry: ", {"geometry": {"type": "Point", "coordinates": ["x", 1]}}),
    ):
        with pytest.raises(DatasetError, match=fault):
            read_geojson(geojson(tmp_path / "a.json", *features))
    cut = geojson(tmp_path / "a.json", feature(24.9, 60.1))
    for text in (cut.read_text()[:-10], "[" * 100_000, "[" + "9" * 5_000 + "]"):
        cut.write_text(text)
        with pytest.raises(DatasetError, match=r"not a GeoJSON FeatureCollection .*export the layer again"):
            read_geojson(cut)


@pytest.mark.parametrize(
    "odd",
    [
        feature(10**400, 52.0),
        {**feature(1.0, 2.0), "properties": [1]},
        {"geometry": {"type": "Point", "coordinates": "ab"}},
        {**feature(1.0, 2.0), "id": "\ud800"},
    ],
)
def test_geojson_features_with_other_types_are_refused(tmp_path: Path, odd: dict[str, object]) -> None:
    with pytest.raises(DatasetError, match="not a GeoJSON FeatureCollection"):
        read_geojson(geojson(tmp_path / "a.geojson", feature(13.0, 52.0), odd))


@pytest.fixture
def extract(tmp_path: Path) -> Path:
    pytest.importorskip("osmium", reason="pyosmium is not installed")
    path = tmp_path / "town.osm"
    path.write_text(OSM)
    return path


def test_osm_nodes_that_are_street_furniture(extract: Path) -> None:
    objects = read_osm(extract)
    np.testing.assert_allclose(objects.positions, [[60.1, 24.9, 0.0], [60.2, 24.8, 0.0], [60.5, 24.5, 0.0]])
    assert objects.labels == ("tree", "street_lamp", "traffic_sign")
    assert objects.ids == ("n1", "n2", "n5")


def test_osm_tags_can_be_chosen(extract: Path) -> None:
    assert read_osm(extract, tags=["highway=crossing"]).labels == ("crossing",)
    assert read_osm(extract, tags=["ref"]).labels == ("ref",)
    with pytest.raises(DatasetError, match="--tag"):
        read_osm(extract, tags=["nothing"])


def test_osm_pbf_and_a_truncated_one(extract: Path, tmp_path: Path) -> None:
    import osmium

    path = tmp_path / "town.osm.pbf"
    with osmium.SimpleWriter(str(path)) as writer:
        for number in range(20_000):
            node = osmium.osm.mutable.Node(
                id=number + 1, location=(24.9, 60.1 + 1e-6 * number), tags={"natural": "tree"}
            )
            writer.add_node(node)
    assert len(read_osm(path)) == 20_000
    path.write_bytes(path.read_bytes()[:-300])
    with pytest.raises(DatasetError, match=r"town\.osm\.pbf: not an extract of OpenStreetMap, or truncated"):
        read_osm(path)


@pytest.mark.parametrize(
    ("right", "wrong"), [('lat="60.1"', 'lat="1e9000100"'), ('id="1"', 'id="99999999999999999999"')]
)
def test_osm_numbers_that_are_none(extract: Path, right: str, wrong: str) -> None:
    extract.write_text(OSM.replace(right, wrong))
    with pytest.raises(DatasetError, match="not an extract of OpenStreetMap"):
        read_osm(extract)
