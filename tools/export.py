"""dslam export."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from tools.arguments import SlamLog, check_outputs

if TYPE_CHECKING:
    from logs.messages import Record

_TRAJECTORY, _GRAPH, _MAP = "/slam/trajectory_stamped", "/slam/graph", "/slam/map"
_KINDS = {_TRAJECTORY: "trajectory", _GRAPH: "factor_graph", _MAP: "object_map"}


def export(
    log: SlamLog,
    tum: Annotated[Path | None, typer.Option(metavar="FILE", help="Trajectory: stamp x y z qx qy qz qw.")] = None,
    kitti: Annotated[Path | None, typer.Option(metavar="FILE", help="Trajectory: 3 x 4 matrix of the body.")] = None,
    g2o: Annotated[Path | None, typer.Option(metavar="FILE", help="Keyframes, landmarks and all factors.")] = None,
) -> None:
    """Write the trajectory or the graph in the text formats of other programs.

    Example: dslam export map.mcap --tum trajectory.txt --g2o graph.g2o
    """
    if tum is None and kitti is None and g2o is None:
        raise typer.BadParameter("nothing to write; give --tum, --kitti or --g2o.")
    check_outputs([tum, kitti, g2o], [log])
    from logs.messages import FactorGraphRecord, ObjectMapRecord, TrajectoryRecord
    from slam.common.errors import InputDataError
    from slam.formats.trajectory_and_graph import write_g2o, write_kitti, write_tum
    from tools import console

    found = _read(log)
    trajectory, graph, object_map = (found.get(topic) for topic in (_TRAJECTORY, _GRAPH, _MAP))
    if not isinstance(trajectory, TrajectoryRecord) or not isinstance(graph, FactorGraphRecord):
        raise InputDataError(
            f"{log} has no final trajectory and graph ({_TRAJECTORY}, {_GRAPH}); give one that 'dslam replay' finished"
        )
    if tum is not None:
        write_tum(tum, trajectory)
        console.show(f"{tum}: {len(trajectory.stamps_ns)} poses")
    if kitti is not None:
        write_kitti(kitti, trajectory)
        console.show(f"{kitti}: {len(trajectory.stamps_ns)} poses")
    if g2o is not None:
        write_g2o(g2o, graph, object_map if isinstance(object_map, ObjectMapRecord) else None)
        console.show(f"{g2o}: {len(graph.keyframe_ids)} keyframes, {len(graph.edge_kinds)} edges")


def _read(path: Path) -> dict[str, Record]:
    from logs.container.limits import RESULT_LIMITS
    from logs.reader import LogReader
    from logs.selection import Selection

    with LogReader(path, RESULT_LIMITS) as reader:
        return {entry.topic: entry.record for entry in reader.records(Selection.of(_KINDS))}
