"""dslam import map: a map of objects from open data."""

from collections import Counter
from dataclasses import replace
from pathlib import Path
from typing import Annotated

import typer

from tools.arguments import Json, check_outputs, parse_origin

NewMap = Annotated[Path, typer.Argument(metavar="MAP.mcap", help="The map to write.")]
Origin = Annotated[
    str | None,
    typer.Option(metavar="LAT,LON", help="Origin of the map; by default the median position of objects in degrees."),
]
Label = Annotated[str | None, typer.Option("--class", metavar="NAME", help="Assign this class to all objects.")]
SURVEYED_SIGMA_M, DRAWN_SIGMA_M = 0.3, 1.0


def map_of_objects(
    output: NewMap,
    file: Annotated[
        Path,
        typer.Option(
            metavar="FILE",
            help="OpenStreetMap (.osm, .osm.gz, .osm.pbf), GeoJSON (.geojson, .json; points in WGS 84), or a "
            "table: CSV with a header.",
        ),
    ],
    tag: Annotated[
        list[str] | None,
        typer.Option(
            metavar="KEY[=VALUE]",
            help="Tag of the objects in OpenStreetMap, instead of those of street furniture. Repeatable.",
        ),
    ] = None,
    origin: Origin = None,
    label: Label = None,
    sigma: Annotated[
        float | None,
        typer.Option(
            metavar="METRES",
            min=0.01,
            help=f"Standard deviation of a coordinate of an object; by default {SURVEYED_SIGMA_M:g}, and "
            f"{DRAWN_SIGMA_M:g} for OpenStreetMap.",
        ),
    ] = None,
    json: Json = False,
) -> None:
    """A map of objects from open data, in which 'relocalize' and 'replay --map' find a robot.

    Columns of a table: x_m and y_m, or lat and lon in degrees; optionally z_m, class and id. --origin is the place on
    earth where x and y are 0; x points east, y north. OpenStreetMap needs pyosmium: pip install
    'descriptellation-slam[osm]'.

    Example: dslam import map town_map.mcap --file objects.csv --origin 60.17,24.94
    """
    check_outputs([output], [file])
    import numpy as np

    from logs.importers.tables import UNLABELLED
    from slam.localization.map_import import import_map
    from slam.place_recognition.imported_map import save_imported_map
    from tools import console

    suffix = Path(file.name.removesuffix(".gz")).suffix
    is_drawn = suffix in (".osm", ".pbf", ".bz2")
    if is_drawn:
        from logs.importers.maps.osm import read_osm

        objects = read_osm(file, tags=tag or ())
    elif suffix in (".geojson", ".json"):
        from logs.importers.maps.geojson import read_geojson

        objects = read_geojson(file)
    else:
        from logs.importers.maps.object_table import read_object_table

        objects = read_object_table(file)
    if label is not None:
        objects = replace(objects, labels=(label,) * len(objects))
    sigma_m = sigma or (DRAWN_SIGMA_M if is_drawn else SURVEYED_SIGMA_M)
    imported = import_map(objects, sigma_m=sigma_m, origin=None if origin is None else parse_origin(origin))
    save_imported_map(output, imported)
    notes, georeference = list(objects.notes), imported.georeference
    if label is None and UNLABELLED in objects.labels:
        unlabelled = f"{objects.labels.count(UNLABELLED)} of {len(objects)} objects"
        notes.append(f"{unlabelled} have no class and are of the class {UNLABELLED}; --class NAME sets one for all")
    if georeference is None:
        notes.append("origin unknown: give --origin LAT,LON for poses in latitude and longitude")
    width_m, height_m = np.ptp(imported.positions[:, :2], axis=0).tolist()
    figures = {
        "output": output,
        "object_count": len(imported),
        "class_counts": dict(Counter(objects.labels).most_common()),
        "width_m": width_m,
        "height_m": height_m,
        "origin": georeference and [georeference.latitude_deg, georeference.longitude_deg],
        "notes": notes,
    }
    console.report(figures, as_json=json)
