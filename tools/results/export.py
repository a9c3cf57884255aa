"""dslam export."""

from __future__ import annotations

from enum import StrEnum
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from tools.arguments import check_outputs

if TYPE_CHECKING:
    from logs.messages import ObjectMapRecord, TrajectoryRecord
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
        typer.Argument(metavar="OUT.mcap", help="A log that 'dslam replay' wrote, or a saved map.", show_default=False),
    ],
    of: Annotated[
        Track, typer.Option("--of", help="Which poses --tum, --kitti and --ros2-bag hold: those of the final map, ...")
    ] = Track.ESTIMATE,
    tum: Annotated[Path | None, _file("Trajectory: stamp x y z qx qy qz qw.")] = None,
    kitti: Annotated[Path | None, _file("Trajectory: 3 x 4 matrix of the body.")] = None,
    kitti_camera: Annotated[
        Path | None, _file("The same of a camera at the body: z ahead, x right, from its first pose.")
    ] = None,
    geodetic: Annotated[Path | None, _file("Trajectory: latitude, longitude and altitude, a table.")] = None,
    g2o: Annotated[Path | None, _file("Keyframes, landmarks and all factors; no robust kernels.")] = None,
    csv: Annotated[Path | None, _file("Landmarks: a table.")] = None,
    geojson: Annotated[Path | None, _file("Landmarks: places on earth (WGS 84).")] = None,
    ply: Annotated[Path | None, _file("Landmarks: coloured points.")] = None,
    ros2_bag: Annotated[
        Path | None, typer.Option(metavar="FOLDER", help="ROS 2 bag: Odometry, Path, markers, detections, frames.")
    ] = None,
    origin: Annotated[
        str | None,
        typer.Option(
            metavar="LAT,LON[,ALT[,YAW]]",
            help="Where on earth the map has its origin (deg, deg, m), and the heading of x from east to north (deg).",
        ),
    ] = None,
) -> None:
    """Write trajectory, landmarks or graph for other programs.

    Example: dslam export map.mcap --tum trajectory.txt --csv landmarks.csv --ros2-bag bag
    """
    of_landmarks, of_poses = [csv, geojson, ply, ros2_bag], [tum, kitti, kitti_camera, geodetic, ros2_bag]
    outputs = [tum, kitti, kitti_camera, geodetic, g2o, csv, geojson, ply]
    if not any([*outputs, ros2_bag]):
        raise typer.BadParameter(
            "nothing to write; give --tum, --kitti, --geodetic, --g2o, --csv, --geojson, --ply or --ros2-bag."
        )
    check_outputs(outputs, [log])
    from slam.evaluation.inputs.records import read_records
    from tools import console

    records = read_records(log)
    written: list[str] = []
    if any(of_poses):
        track = _track(log, records, of)
        written += _write_track(log, track, tum, kitti, kitti_camera, geodetic, origin)
    if any(of_landmarks):
        objects = _landmarks(log, records)
        written += _write_landmarks(log, objects, csv, geojson, ply, origin)
    if ros2_bag is not None:
        written.append(_write_bag(ros2_bag, track, objects, records))
    if g2o is not None:
        written.append(_write_graph(log, g2o, records))
    console.show(*written)


def _write_track(
    log: Path,
    track: TrajectoryRecord,
    tum: Path | None,
    kitti: Path | None,
    kitti_camera: Path | None,
    geodetic: Path | None,
    origin: str | None,
) -> list[str]:
    from slam.formats import trajectory_and_graph as text

    for path, write in ((tum, text.write_tum), (kitti, text.write_kitti), (kitti_camera, text.write_kitti_camera)):
        if path is not None:
            write(path, track)
    if geodetic is not None:
        text.write_geodetic(geodetic, track, _georeference(log, origin))
    paths = (tum, kitti, kitti_camera, geodetic)
    return [f"{path}: {len(track.stamps_ns)} poses" for path in paths if path is not None]


def _write_landmarks(
    log: Path, objects: ObjectMapRecord, csv: Path | None, geojson: Path | None, ply: Path | None, origin: str | None
) -> list[str]:
    from slam.formats import landmark_tables

    if csv is not None:
        landmark_tables.write_csv(csv, objects)
    if geojson is not None:
        landmark_tables.write_geojson(geojson, objects, _georeference(log, origin))
    if ply is not None:
        landmark_tables.write_ply(ply, objects)
    return [f"{path}: {len(objects.ids)} landmarks" for path in (csv, geojson, ply) if path is not None]


def _write_bag(folder: Path, track: TrajectoryRecord, objects: ObjectMapRecord, records: EvaluationRecords) -> str:
    from slam.formats import ros2_bag as bag

    body_frame = records.odometry[0].child_frame_id if records.odometry else "base_link"
    bag.write_ros2_bag(folder, track, objects, body_frame=body_frame)
    return f"{folder}: {len(track.stamps_ns)} poses, {len(objects.ids)} landmarks"


def _write_graph(log: Path, path: Path, records: EvaluationRecords) -> str:
    from slam.formats import trajectory_and_graph as text

    if records.graph is None:
        raise _no_result(log)
    text.write_g2o(path, records.graph, records.object_map)
    return (
        f"{path}: {len(records.graph.keyframe_ids)} keyframes, {len(records.graph.edge_kinds)} edges, without the "
        "robust kernels of the configuration, which g2o files have no place for"
    )


def _track(log: Path, records: EvaluationRecords, of: Track) -> TrajectoryRecord:
    import numpy as np

    from logs.messages import TrajectoryRecord
    from slam.common.errors import InputDataError

    if of == Track.ESTIMATE:
        if records.trajectory is None or not len(records.trajectory.stamps_ns):
            raise _no_result(log)
        return records.trajectory
    stamped = {
        Track.ONLINE: ("map", [(pose.stamp_ns, pose.T_map_body) for pose in records.online_poses]),
        Track.ODOMETRY: ("odom", [(pose.stamp_ns, pose.T_odom_body) for pose in records.odometry]),
        Track.TRUTH: ("world", [(pose.stamp_ns, pose.T_world_body) for pose in records.true_poses]),
    }
    frame, poses = stamped[of]
    if not poses:
        raise InputDataError(f"{log} has no poses of the {of}; choose another by --of")
    stamps_ns, first = np.unique([stamp_ns for stamp_ns, _ in poses], return_index=True)
    return TrajectoryRecord(int(stamps_ns[-1]), frame, stamps_ns, np.stack([poses[row][1] for row in first]))


def _landmarks(log: Path, records: EvaluationRecords) -> ObjectMapRecord:
    from logs.container.limits import RESULT_LIMITS
    from logs.reader import LogReader
    from slam.object_map.map_io import METADATA, confirmed, load_map

    with LogReader(log, RESULT_LIMITS) as reader:
        is_map = METADATA in reader.metadata()
    if is_map:
        return load_map(log).objects
    if records.object_map is None:
        raise _no_result(log)
    return confirmed(records.object_map)


def _georeference(log: Path, origin: str | None) -> Georeference:
    """Where the map is: as ``origin`` says, else as the log does."""
    import math

    from logs.container.limits import RESULT_LIMITS
    from logs.reader import LogReader
    from slam.common.errors import InputDataError
    from slam.common.georeference import Georeference

    if origin is not None:
        try:
            numbers = [float(word) for word in origin.split(",")]
            if not (2 <= len(numbers) <= 4 and all(map(math.isfinite, numbers))):
                raise ValueError
        except ValueError:
            raise typer.BadParameter(f"{origin!r} is not LAT,LON, LAT,LON,ALT or LAT,LON,ALT,YAW.") from None
        latitude, longitude, altitude_m, yaw_deg = [*numbers, *([0.0] * (4 - len(numbers)))]
        return Georeference(latitude, longitude, altitude_m, math.radians(yaw_deg))
    with LogReader(log, RESULT_LIMITS) as reader:
        for values in reader.metadata().values():
            if "georeference" in values:
                return Georeference.from_json(values["georeference"])
    raise InputDataError(f"{log} does not tell where on earth its map is; give --origin LAT,LON[,ALT[,YAW]]")


def _no_result(log: Path) -> Exception:
    from slam.common.errors import InputDataError

    return InputDataError(f"{log} has no final trajectory, map and graph; give one that 'dslam replay' finished")
