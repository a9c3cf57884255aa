"""dslam export."""

from __future__ import annotations

from enum import StrEnum
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from tools.arguments import check_outputs, parse_origin

if TYPE_CHECKING:
    from logs.messages import FactorGraphRecord, ObjectMapRecord, TrajectoryRecord
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
        typer.Argument(
            metavar="OUT.mcap", help="A log that 'dslam replay' wrote, or a map of any kind.", show_default=False
        ),
    ],
    of: Annotated[
        Track, typer.Option("--of", help="Poses for --tum, --kitti and --ros2-bag: of the final map, online, ...")
    ] = Track.ESTIMATE,
    tum: Annotated[Path | None, _file("Trajectory: stamp x y z qx qy qz qw.")] = None,
    kitti: Annotated[Path | None, _file("Trajectory: 3 x 4 matrix of the body.")] = None,
    geodetic: Annotated[Path | None, _file("Trajectory: latitude, longitude and altitude, a table.")] = None,
    g2o: Annotated[Path | None, _file("Keyframes, landmarks and all factors; no robust kernels.")] = None,
    csv: Annotated[Path | None, _file("Landmarks: a table.")] = None,
    geojson: Annotated[Path | None, _file("Landmarks: places on earth (WGS 84).")] = None,
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
    outputs = [tum, kitti, geodetic, g2o, csv, geojson]
    if not any([*outputs, ros2_bag]):
        raise typer.BadParameter(
            "nothing to write; give --tum, --kitti, --geodetic, --g2o, --csv, --geojson or --ros2-bag."
        )
    check_outputs(outputs, [log])
    from slam.formats import landmark_tables as tables
    from slam.formats import trajectories as text
    from slam.formats.g2o import write_g2o
    from slam.formats.ros2_bag import write_ros2_bag
    from tools import console

    source = _Source(log, of, origin)
    for path, write in ((tum, text.write_tum), (kitti, text.write_kitti)):
        if path is not None:
            write(path, source.track)
            console.show(f"{path}: {len(source.track.stamps_ns)} poses")
    if geodetic is not None:
        text.write_geodetic(geodetic, source.track, source.georeference)
        console.show(f"{geodetic}: {len(source.track.stamps_ns)} poses")
    if csv is not None:
        tables.write_csv(csv, source.objects)
        console.show(f"{csv}: {len(source.objects.ids)} landmarks")
    if geojson is not None:
        tables.write_geojson(geojson, source.objects, source.georeference)
        console.show(f"{geojson}: {len(source.objects.ids)} landmarks")
    if ros2_bag is not None:
        odometry = source.records.odometry
        body_frame = odometry[0].child_frame_id if odometry else "base_link"
        write_ros2_bag(ros2_bag, source.track, source.objects, body_frame=body_frame)
        console.show(f"{ros2_bag}: {len(source.track.stamps_ns)} poses, {len(source.objects.ids)} landmarks")
    if g2o is not None:
        graph = source.graph
        write_g2o(g2o, graph, source.records.object_map)
        console.show(
            f"{g2o}: {len(graph.keyframe_ids)} keyframes, {len(graph.edge_kinds)} edges, without the robust kernels of "
            "the configuration, which g2o files cannot hold"
        )


class _Source:
    """The records of a log to be exported, read at the first use."""

    def __init__(self, log: Path, of: Track, origin: str | None) -> None:
        self._log = log
        self._of = of
        self._origin = origin

    @cached_property
    def records(self) -> EvaluationRecords:
        from slam.evaluation.inputs.records import read_records

        return read_records(self._log)

    @cached_property
    def track(self) -> TrajectoryRecord:
        from logs.messages import TrajectoryRecord
        from slam.common.errors import InputDataError

        records = self.records
        if self._of == Track.ESTIMATE:
            if records.trajectory is None or not len(records.trajectory.stamps_ns):
                raise self._no_result()
            return records.trajectory
        frame, path = {
            Track.ONLINE: ("map", records.online_path),
            Track.ODOMETRY: ("odom", records.odometry_path),
            Track.TRUTH: ("world", records.true_path),
        }[self._of]
        if not len(path):
            raise InputDataError(f"{self._log} has no poses of the {self._of}; choose another with --of")
        return TrajectoryRecord(int(path.stamps_ns[-1]), frame, path.stamps_ns, path.T_world_body)

    @cached_property
    def objects(self) -> ObjectMapRecord:
        from slam.library import read_map

        return read_map(self._log)

    @property
    def graph(self) -> FactorGraphRecord:
        if self.records.graph is None:
            raise self._no_result()
        return self.records.graph

    @cached_property
    def georeference(self) -> Georeference:
        """The georeference: that of the option, else that of the log."""
        from slam.common.errors import InputDataError
        from slam.common.georeference import Georeference

        if self._origin is not None:
            return parse_origin(self._origin)
        for values in self._metadata.values():
            if "georeference" in values:
                return Georeference.from_json(values["georeference"])
        raise InputDataError(f"{self._log} has no georeference; give --origin LAT,LON[,ALT[,YAW]]")

    @cached_property
    def _metadata(self) -> dict[str, dict[str, str]]:
        from logs.container.limits import RESULT_LIMITS
        from logs.reader import LogReader

        with LogReader(self._log, RESULT_LIMITS) as reader:
            return dict(reader.metadata())

    def _no_result(self) -> Exception:
        from slam.common.errors import InputDataError

        return InputDataError(
            f"{self._log} has no final trajectory, map and graph; give one that 'dslam replay' finished"
        )
