"""dslam export."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

import typer

from tools.arguments import check_outputs, parse_origin

if TYPE_CHECKING:
    from slam.common.georeference import Georeference

_REMEDY = "give a log that 'dslam replay' finished"


def _file(help_: str) -> Any:
    return typer.Option(metavar="FILE", help=help_)


def export(
    log: Annotated[
        Path, typer.Argument(metavar="OUT.mcap", help="A log that 'dslam replay' wrote, or a map of any kind.")
    ],
    of: Annotated[
        Literal["estimate", "online", "odometry", "truth"],
        typer.Option(help="Poses for --tum, --kitti and --geodetic: of the final map, online, ..."),
    ] = "estimate",
    tum: Annotated[Path | None, _file("Trajectory: stamp x y z qx qy qz qw.")] = None,
    kitti: Annotated[Path | None, _file("Trajectory: 3 x 4 matrix of the body.")] = None,
    geodetic: Annotated[Path | None, _file("Trajectory: latitude, longitude and altitude, a table.")] = None,
    g2o: Annotated[Path | None, _file("Keyframes, landmarks and all factors; no robust kernels.")] = None,
    csv: Annotated[Path | None, _file("Landmarks: a table.")] = None,
    geojson: Annotated[Path | None, _file("Landmarks: places on earth (WGS 84).")] = None,
    origin: Annotated[
        str | None,
        typer.Option(
            metavar="LAT,LON[,ALT[,YAW]]",
            help="Origin of the map: latitude, longitude, altitude; heading of its x axis from east (deg, m).",
        ),
    ] = None,
) -> None:
    """Write trajectory, landmarks or graph for other programs.

    Example: dslam export map.mcap --tum trajectory.txt --csv landmarks.csv
    """
    outputs = [tum, kitti, geodetic, g2o, csv, geojson]
    if not any(outputs):
        raise typer.BadParameter("nothing to write; give --tum, --kitti, --geodetic, --g2o, --csv or --geojson.")
    check_outputs(outputs, [log])
    from slam.common.errors import InputDataError
    from slam.evaluation.inputs.records import read_records
    from slam.formats import landmark_tables as tables
    from slam.formats import trajectories as text
    from slam.formats.g2o import write_g2o
    from slam.library import read_map
    from tools import console

    georeference = _find_georeference(log, origin) if geodetic or geojson else None
    records = read_records(log)
    if tum or kitti or geodetic:
        track = {
            "estimate": records.final_path,
            "online": records.online_path,
            "odometry": records.odometry_path,
            "truth": records.true_path,
        }[of]
        if not track:
            raise InputDataError(f"{log} has no poses of the {of}; {_REMEDY}, or choose other poses by --of")
        if georeference and geodetic:
            text.write_geodetic(geodetic, track.stamps_ns, track.T_world_body, georeference)
        if tum:
            text.write_tum(tum, track.stamps_ns, track.T_world_body)
        if kitti:
            text.write_kitti(kitti, track.T_world_body)
        for path in filter(None, (tum, kitti, geodetic)):
            console.show(f"{path}: {len(track)} poses")
    if csv or geojson:
        objects = read_map(log)
        if georeference and geojson:
            tables.write_geojson(geojson, objects, georeference)
        if csv:
            tables.write_csv(csv, objects)
        for path in filter(None, (csv, geojson)):
            console.show(f"{path}: {len(objects.ids)} landmarks")
    if g2o:
        if records.graph is None or records.object_map is None:
            raise InputDataError(f"{log} has no final map and graph; {_REMEDY}")
        write_g2o(g2o, records.graph, records.object_map)
        count = len(records.graph.edge_kinds)
        console.show(f"{g2o}: {count} edges, without robust kernels, which g2o cannot hold")


def _find_georeference(log: Path, origin: str | None) -> "Georeference":
    """Where the map is: as the option says, else as the log does."""
    from logs.container.limits import RESULT_LIMITS
    from logs.reader import LogReader
    from slam.common.errors import InputDataError
    from slam.common.georeference import Georeference

    if origin is not None:
        return parse_origin(origin)
    with LogReader(log, RESULT_LIMITS) as reader:
        for values in reader.metadata().values():
            if "georeference" in values:
                return Georeference.from_json(values["georeference"])
    raise InputDataError(f"{log} has no georeference; give --origin LAT,LON[,ALT[,YAW]]")
