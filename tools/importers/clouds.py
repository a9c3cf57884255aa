"""dslam import semantic-kitti."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from tools.arguments import Json, NewLog, check_outputs


def semantic_kitti(
    output: NewLog,
    sequence: Annotated[
        Path | None,
        typer.Option(metavar="FOLDER", help="A sequence: velodyne/, labels/, poses.txt, calib.txt and times.txt."),
    ] = None,
    scans: Annotated[Path | None, typer.Option(metavar="FOLDER", help="NNNNNN.bin, where not of --sequence.")] = None,
    labels: Annotated[
        Path | None, typer.Option(metavar="FOLDER", help="NNNNNN.label, for example predictions.")
    ] = None,
    odometry: Annotated[Path | None, typer.Option(metavar="POSES", help="Of the left camera, KITTI format.")] = None,
    calib: Annotated[Path | None, typer.Option(metavar="FILE", help="KITTI's calib.txt.")] = None,
    times: Annotated[Path | None, typer.Option(metavar="FILE", help="KITTI's times.txt, seconds.")] = None,
    ground_truth: Annotated[
        Path | None, typer.Option(metavar="POSES", help="True poses of the left camera; for evaluation only.")
    ] = None,
    json: Json = False,
) -> None:
    """SemanticKITTI: objects of labelled LiDAR scans. Needs the extra "clouds" (Open3D).

    Poses that do not fit the scans, because of a wrong calibration, are refused.

    Example: dslam import semantic-kitti drive.mcap --sequence dataset/sequences/00 --odometry odometry.txt
    --ground-truth dataset/sequences/00/poses.txt
    """
    names = {"velodyne": scans, "labels": labels, "poses.txt": odometry, "calib.txt": calib, "times.txt": times}
    if sequence is None and None in names.values():
        raise typer.BadParameter(
            "without it --scans, --labels, --odometry, --calib and --times are needed.", param_hint="--sequence"
        )
    paths = [given if given is not None else (sequence or Path()) / name for name, given in names.items()]
    check_outputs([output], [*paths, ground_truth])
    from logs.clouds.semantic_kitti import import_semantic_kitti
    from tools import console
    from tools.import_logs import tell

    with console.progress_bar("finding objects", "writing the log") as progress:
        summary = import_semantic_kitti(
            output,
            scans=paths[0],
            labels=paths[1],
            odometry=paths[2],
            calib=paths[3],
            times=paths[4],
            ground_truth=ground_truth,
            progress=progress,
        )
    tell(output, summary, json=json)
