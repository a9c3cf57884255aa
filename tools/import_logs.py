"""dslam import."""

from dataclasses import asdict
from pathlib import Path
from typing import Annotated

import typer

from tools.arguments import Json, NewLog, check_outputs
from tools.importers import maps

app = typer.Typer(
    help="Convert other data to a log for 'dslam replay', or to a map for its --map.", no_args_is_help=True
)
app.command("map")(maps.map_of_objects)


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
