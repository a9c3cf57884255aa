"""dslam export."""

from __future__ import annotations

from enum import StrEnum
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from tools.arguments import check_outputs, parse_origin

if TYPE_CHECKING:
    from logs.messages import TrajectoryRecord
    from slam.common.georeference import Georeference
    from slam.evaluation.inputs.records import EvaluationRecords


class Track(StrEnum):
    """Which poses of a drive."""

    ESTIMATE = "estimate"
    ONLINE = "online"
    ODOMETRY = "odometry"
    TRUTH = "truth"


def _file(help_: str) -> Any:
    return typer.Option(metavar="FILE", help=help_)


def export(
    log: Annotated[
        Path,
        typer.Argument(metavar="OUT.mcap", help="A log that 'dslam replay' wrote, or a map of any kind."),
    ],
    of: Annotated[
        Track, typer.Option(help="Poses for --tum, --kitti and --ros2-bag: of the final map, online, ...")
    ] = Track.ESTIMATE,
    tum: Annotated[Path | None, _file("Trajectory: stamp x y z qx qy qz qw.")] = None,
    kitti: Annotated[Path | None, _file("Trajectory: 3 x 4 matrix of the body.")] = None,
    geodetic: Annotated[Path | None, _file("Trajectory: latitude, longitude and altitude, a table.")] = None,
    g2o: Annotated[Path | None, _file("Keyframes, landmarks and all factors; no robust kernels.")] = None,
    csv: Annotated[Path | None, _file("Landmarks: a table.")] = None,
    geojson: Annotated[Path | None, _file("Landmarks: places on earth (WGS 84).")] = None,
    gpkg: Annotated[Path | None, _file("The same as a GeoPackage; needs geopandas.")] = None,
    ros2_bag: Annotated[
        Path | None, typer.Option(metavar="FOLDER", help="ROS 2 bag: Odometry, Path, detections, frames.")
    ] = None,
    origin: Annotated[
        str | None,
        typer.Option(
            metavar="LAT,LON[,ALT[,YAW]]",
            help="Origin of the map: latitude, longitude, altitude; heading of its x axis from east (deg, m).",
        ),
    ] = None,
) -> None:
    """Write trajectory, landmarks or graph for other programs.

    Example: dslam export map.mcap --tum trajectory.txt --csv landmarks.csv --ros2-bag bag
    """
    outputs = [tum, kitti, geodetic, g2o, csv, geojson, gpkg]
    if not any([*outputs, ros2_bag]):
        raise typer.BadParameter(
            "nothing to write; give --tum, --kitti, --geodetic, --g2o, --csv, --geojson, --gpkg or --ros2-bag."
        )
    check_outputs(outputs, [log])
    from slam.evaluation.inputs.records import read_records
    from slam.formats import landmark_tables as tables
    from slam.formats import trajectories as text
    from slam.formats.g2o import write_g2o
    from slam.formats.ros2_bag import write_ros2_bag
    from slam.library import read_map
    from tools import console

    georeference = _georeference(log, origin) if geodetic or geojson or gpkg else None
    if tum or kitti or geodetic or g2o or ros2_bag:
        records = read_records(log)
    if tum or kitti or geodetic or ros2_bag:
        track = _track(log, records, of)
        poses = f"{len(track.stamps_ns)} poses"
    if csv or geojson or gpkg or ros2_bag:
        objects = read_map(log)
        landmarks = f"{len(objects.ids)} landmarks"
    if tum:
        text.write_tum(tum, track)
        console.show(f"{tum}: {poses}")
    if kitti:
        text.write_kitti(kitti, track)
        console.show(f"{kitti}: {poses}")
    if geodetic and georeference:
        text.write_geodetic(geodetic, track, georeference)
        console.show(f"{geodetic}: {poses}")
    if csv:
        tables.write_csv(csv, objects)
        console.show(f"{csv}: {landmarks}")
    if geojson and georeference:
        tables.write_geojson(geojson, objects, georeference)
        console.show(f"{geojson}: {landmarks}")
    if gpkg and georeference:
        tables.write_geopackage(gpkg, objects, georeference)
        console.show(f"{gpkg}: {landmarks}")
    if ros2_bag:
        body_frame = records.odometry[0].child_frame_id if records.odometry else "base_link"
        write_ros2_bag(ros2_bag, track, objects, body_frame=body_frame)
        console.show(f"{ros2_bag}: {poses}, {landmarks}")
    if g2o:
        if records.graph is None:
            raise _no_result(log)
        write_g2o(g2o, records.graph, records.object_map)
        console.show(f"{g2o}: {len(records.graph.edge_kinds)} edges, without robust kernels, which g2o cannot hold")


def _track(log: Path, records: EvaluationRecords, of: Track) -> TrajectoryRecord:
    from logs.messages import TrajectoryRecord
    from slam.common.errors import InputDataError

    if of == Track.ESTIMATE:
        if records.trajectory is None or not len(records.trajectory.stamps_ns):
            raise _no_result(log)
        return records.trajectory
    frame, path = {
        Track.ONLINE: ("map", records.online_path),
        Track.ODOMETRY: ("odom", records.odometry_path),
        Track.TRUTH: ("world", records.true_path),
    }[of]
    if not len(path):
        raise InputDataError(f"{log} has no poses of the {of}; choose another with --of")
    return TrajectoryRecord(int(path.stamps_ns[-1]), frame, path.stamps_ns, path.T_world_body)


def _georeference(log: Path, origin: str | None) -> Georeference:
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


def _no_result(log: Path) -> Exception:
    from slam.common.errors import InputDataError

    return InputDataError(f"{log} has no final trajectory, map and graph; give one that 'dslam replay' finished")
