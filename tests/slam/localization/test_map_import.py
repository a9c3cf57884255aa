"""Objects of a source become a map: their origin, and coordinates that cannot be."""

import numpy as np
import pytest

from logs.importers.maps.map_objects import MapObjects
from logs.messages import FloatArray
from slam.common.errors import SavedMapError
from slam.common.georeference import Georeference
from slam.localization.map_import import import_map

XY = np.random.default_rng(1).uniform(-300.0, 300.0, (40, 2))
UTM = np.array([385_000.0, 6_672_000.0])
HELSINKI = Georeference(60.17, 24.94)


def objects(plane: FloatArray, *, is_geodetic: bool = False) -> MapObjects:
    positions = np.column_stack([plane, np.zeros(len(plane))])
    names = tuple(map(str, range(len(plane))))
    return MapObjects("town.csv", positions, ("tree",) * len(plane), names, is_geodetic, "")


def degrees() -> FloatArray:
    return HELSINKI.to_geodetic(np.column_stack([XY, np.zeros(len(XY))]))[:, :2]


def test_degrees_become_metres_around_their_middle_or_an_origin() -> None:
    given = import_map(objects(degrees(), is_geodetic=True), sigma_m=0.3, origin=HELSINKI)
    found = given.positions[np.argsort(given.positions[:, 0]), :2]
    np.testing.assert_allclose(found, XY[np.argsort(XY[:, 0])], atol=1e-6)
    middle = import_map(objects(degrees(), is_geodetic=True), sigma_m=0.3).georeference
    np.testing.assert_allclose([middle.latitude_deg, middle.longitude_deg], np.median(degrees(), axis=0), atol=1e-6)


def test_metres_without_an_origin_have_no_place_on_earth() -> None:
    assert import_map(objects(XY + UTM), sigma_m=0.3).georeference is None


def test_degrees_as_metres_are_refused() -> None:
    with pytest.raises(SavedMapError, match=r"town\.csv: the objects are .* apart; name the columns lat and lon"):
        import_map(objects(degrees()), sigma_m=0.3)


@pytest.mark.parametrize("is_geodetic", [False, True])
def test_coordinates_that_count_from_elsewhere_are_refused(is_geodetic: bool) -> None:
    if is_geodetic:
        far, origin = objects(degrees(), is_geodetic=True), Georeference(0.0, 0.0)
    else:
        far, origin = objects(XY + UTM), HELSINKI
    with pytest.raises(
        SavedMapError, match=r"town\.csv: the nearest object is \d{4} km from the origin .*\(such as UTM\)"
    ):
        import_map(far, sigma_m=0.3, origin=origin)
