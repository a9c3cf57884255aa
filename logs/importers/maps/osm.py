"""Objects of a map in an extract of OpenStreetMap: nodes whose tags say that something stands there."""

from collections.abc import Collection, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from logs.digest import file_sha256
from logs.errors import DatasetError
from logs.importers.maps.map_objects import MapObjects
from logs.storage.regular_file import open_regular

if TYPE_CHECKING:
    import osmium

ANY = "*"
_VALUES: Mapping[str, str] = {
    "advertising": ANY,
    "amenity": "atm bench bicycle_parking bicycle_rental charging_station clock drinking_water fountain grit_bin "
    "motorcycle_parking parking_meter post_box recycling telephone toilets vending_machine waste_basket waste_disposal",
    "barrier": "block bollard cycle_barrier gate lift_gate swing_gate turnstile",
    "emergency": "defibrillator fire_hydrant phone siren",
    "highway": "bus_stop elevator give_way milestone speed_camera stop street_lamp traffic_mirror traffic_signals",
    "historic": "boundary_stone memorial milestone monument wayside_cross wayside_shrine",
    "man_made": "antenna chimney flagpole manhole mast monitoring_station pole pump street_cabinet surveillance tower "
    "utility_pole water_tap",
    "natural": "rock stone tree",
    "power": "pole tower transformer",
    "railway": "buffer_stop milestone signal subway_entrance switch",
    "tourism": "artwork information",
    "traffic_sign": ANY,
}
TAGS: Collection[str] = [f"{key}={value}" for key, values in _VALUES.items() for value in values.split()]
"""Tags that make a node an object, ``KEY=VALUE``; with ``ANY`` all values do, and the class is the key."""


def read_osm(path: Path, *, tags: Sequence[str] = ()) -> MapObjects:
    """Read the nodes of an ``.osm``, ``.osm.gz`` or ``.osm.pbf`` file that are objects.

    Their class is the value of the tag, ``tree`` for ``natural=tree``; the first key counts, by the alphabet.

    Args:
        path: the extract.
        tags: ``KEY=VALUE`` or ``KEY`` that make an object, instead of :data:`TAGS`.

    Raises:
        DatasetError: the file cannot be read, is cut off, or holds no such node.
        ModuleNotFoundError: pyosmium is not installed.
    """
    import osmium

    pairs = [tag.partition("=") for tag in tags or TAGS]
    keys, wanted = dict.fromkeys(key for key, *_ in pairs), {f"{key}={value or ANY}" for key, _, value in pairs}
    found = []
    try:
        open_regular(path).close()
        nodes = osmium.FileProcessor(str(path), osmium.osm.NODE).with_filter(osmium.filter.KeyFilter(*keys))
        for node in nodes:
            label = _class_of(node, wanted)
            if label and node.location.valid():
                found.append((node.location.lat, node.location.lon, label, f"n{node.id}"))
    except (RuntimeError, OSError, ValueError, osmium.InvalidLocationError) as error:
        reason = getattr(error, "strerror", None) or " ".join(str(error).split())
        raise DatasetError(
            f"{path}: not an extract of OpenStreetMap, or truncated ({reason}); download it again"
        ) from error
    if not found:
        names = ", ".join(keys)
        raise DatasetError(f"{path}: no node is an object by its tags ({names}); say which with --tag KEY=VALUE")
    latitudes, longitudes, labels, ids = zip(*found, strict=True)
    positions = np.column_stack([latitudes, longitudes, np.zeros(len(found))])
    return MapObjects(str(path), positions, labels, ids, True, file_sha256(path))


def _class_of(node: "osmium.osm.Node", wanted: Collection[str]) -> str:
    """The value of its first tag that is wanted, or the key where any value is; "" without such a tag."""
    for key, value in sorted((tag.k, tag.v) for tag in node.tags):
        if f"{key}={ANY}" in wanted:
            return key
        if f"{key}={value}" in wanted:
            return value
    return ""
