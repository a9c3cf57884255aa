"""dslam import."""

from collections import Counter
from dataclasses import asdict, replace
from pathlib import Path
from typing import Annotated

import typer

from tools.arguments import Json, NewLog, check_outputs, parse_origin

SURVEYED_SIGMA_M, DRAWN_SIGMA_M = 0.3, 1.0

app = typer.Typer(
    help="Convert other data to a log for 'dslam replay', or to a map for its --map.", no_args_is_help=True
)


@app.command("map")
def map_of_objects(
    output: Annotated[Path, typer.Argument(metavar="MAP.mcap", help="The map to write.")],
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
    origin: Annotated[
        str | None,
        typer.Option(
            metavar="LAT,LON", help="Origin of the map; by default the median position of objects in degrees."
        ),
    ] = None,
    label: Annotated[
        str | None, typer.Option("--class", metavar="NAME", help="Assign this class to all objects.")
    ] = None,
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


@app.command("csv")
def csv(
    output: NewLog,
    odometry: Annotated[Path, typer.Option(metavar="POSES", help="Odometry of the body: TUM, KITTI or CSV.")],
    detections: Annotated[
        Path,
        typer.Option(
            metavar="TABLE",
            help="CSV with a header, positions in the body frame; or a folder of GOSMatch (bow.txt and centroids/).",
        ),
    ],
    gnss: Annotated[
        Path | None,
        typer.Option(metavar="TABLE", help="Fixes of satellites: CSV with stamp_s, latitude_deg, longitude_deg."),
    ] = None,
    ground_truth: Annotated[
        Path | None, typer.Option(metavar="POSES", help="True poses of the body; for evaluation only.")
    ] = None,
    times: Annotated[
        Path | None,
        typer.Option(metavar="FILE", help="File with the time of each pose in seconds, for KITTI's format."),
    ] = None,
    calib: Annotated[
        Path | None,
        typer.Option(metavar="FILE", help="KITTI's calib.txt, if poses in that format are of the left camera."),
    ] = None,
    json: Json = False,
) -> None:
    """Text files: poses of the odometry, a table of detections, fixes of satellites, true poses.

    Files may be compressed with gzip.

    Columns of detections: stamp_s, x_m, y_m, and where known z_m, label, score, sigma_x_m ..., frame,
    object_id (the truth). Other columns are listed and ignored.

    Example: dslam import csv drive.mcap --odometry odometry.tum --detections detections.csv.gz
    """
    check_outputs([output], [odometry, detections, gnss, ground_truth, times, calib])
    from logs.importers.imported_log import write_drive
    from logs.importers.text_log import read_text_log
    from tools import console

    drive = read_text_log(
        odometry=odometry, detections=detections, gnss=gnss, ground_truth=ground_truth, times=times, calib=calib
    )
    summary = write_drive(output, drive.records(), drive.source)
    console.report(
        {
            "output": output,
            **asdict(summary),
            "odometry_format": drive.odometry.format,
            "odometry_length_m": drive.odometry.length_m,
            "columns_left_out": drive.detections.left_out,
            "notes": drive.notes,
        },
        as_json=json,
    )
