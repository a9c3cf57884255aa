"""dslam import."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from tools.arguments import Json, NewLog, check_outputs
from tools.importers import clouds, maps

if TYPE_CHECKING:
    from logs.importers.imported_log import ImportSummary
    from logs.importers.text_log import TextLogSummary

app = typer.Typer(
    help="Turn data of others into a log that 'dslam replay' reads, or into a map for its --map.", no_args_is_help=True
)
app.command()(maps.osm)
app.command()(maps.geojson)
app.command("csv-map")(maps.csv_map)
app.command("semantic-kitti")(clouds.semantic_kitti)
app.command("paris-lille")(clouds.paris_lille)
app.command()(clouds.iqmulus)
app.command()(clouds.ply)
app.command()(clouds.pcd)


@app.command("kitti-objects")
def kitti_objects(
    output: NewLog,
    detections: Annotated[
        Path,
        typer.Option(metavar="ARCHIVE|FOLDER", help="bow.txt and centroids/, as the GOSMatch repository has them."),
    ],
    odometry: Annotated[Path, typer.Option(metavar="POSES", help="Odometry of the left camera, KITTI format.")],
    calib: Annotated[Path, typer.Option(metavar="FILE", help="KITTI's calib.txt; Tr is velodyne to left camera.")],
    times: Annotated[Path, typer.Option(metavar="FILE", help="KITTI's times.txt, seconds.")],
    ground_truth: Annotated[
        Path | None, typer.Option(metavar="POSES", help="True poses of the left camera; for evaluation only.")
    ] = None,
    sequence: Annotated[str | None, typer.Option(help="Which sequence, where there are several.")] = None,
    json: Json = False,
) -> None:
    """KITTI odometry with objects that were clustered in its scans.

    Example: dslam import kitti-objects kitti00.mcap --detections 00.tar.xz --odometry vo.txt --calib calib.txt
    --times times.txt --ground-truth poses/00.txt
    """
    check_outputs([output], [detections, odometry, calib, times, ground_truth])
    from logs.importers.kitti_objects import import_kitti_objects

    tell(
        output,
        import_kitti_objects(
            output,
            detections=detections,
            odometry=odometry,
            calib=calib,
            times=times,
            ground_truth=ground_truth,
            sequence=sequence,
        ),
        json=json,
    )


@app.command("victoria-park")
def victoria_park(
    output: NewLog,
    file: Annotated[
        Path | None, typer.Option(metavar="FILE", help="victoria_park.txt; by default the one that comes with GTSAM.")
    ] = None,
    json: Json = False,
) -> None:
    """Victoria Park: a truck among trees whose identity is known, in the plane.

    Example: dslam import victoria-park park.mcap
    """
    check_outputs([output], [file])
    from logs.importers.victoria_park import import_victoria_park

    tell(output, import_victoria_park(output, path=file), json=json)


@app.command("csv")
def csv(
    output: NewLog,
    odometry: Annotated[Path, typer.Option(metavar="POSES", help="Odometry of the body: TUM, KITTI, EuRoC or CSV.")],
    detections: Annotated[
        Path, typer.Option(metavar="TABLE", help="CSV with a header, or JSON lines; positions in the body frame.")
    ],
    ground_truth: Annotated[
        Path | None, typer.Option(metavar="POSES", help="True poses of the body; for evaluation only.")
    ] = None,
    times: Annotated[
        Path | None, typer.Option(metavar="FILE", help="Seconds of each pose, for KITTI's format.")
    ] = None,
    calib: Annotated[
        Path | None,
        typer.Option(metavar="FILE", help="KITTI's calib.txt, if poses in that format are of the left camera."),
    ] = None,
    pose_format: Annotated[
        str | None,
        typer.Option("--format", metavar="tum|kitti|euroc|csv", help="Of the poses; else found in the files."),
    ] = None,
    json: Json = False,
) -> None:
    """Text files: poses of the odometry, a table of detections, true poses. Files may be packed by gzip.

    Columns of detections: stamp_s, x_m, y_m, and where known z_m, label, score, sigma_x_m ... or cxx ..., diameter_m,
    track_id, frame, object_id (the truth). Others are named and left out.

    Example: dslam import csv drive.mcap --odometry odometry.tum --detections detections.csv.gz
    """
    check_outputs([output], [odometry, detections, ground_truth, times, calib])
    from logs.importers.text_log import import_text_log
    from logs.importers.trajectory_files import TrajectoryFormat

    if pose_format is not None and pose_format not in list(TrajectoryFormat):
        raise typer.BadParameter(f"{pose_format!r} is none of {', '.join(TrajectoryFormat)}.", param_hint="--format")
    summary = import_text_log(
        output,
        odometry=odometry,
        detections=detections,
        ground_truth=ground_truth,
        times=times,
        calib=calib,
        format=TrajectoryFormat(pose_format) if pose_format is not None else None,
    )
    tell(output, summary.written, json=json, text=summary)


def tell(output: Path, summary: ImportSummary, *, json: bool, text: TextLogSummary | None = None) -> None:
    """Print what was written."""
    from tools import console

    duration_s = ((summary.last_stamp_ns or 0) - (summary.first_stamp_ns or 0)) * 1e-9
    if json:
        console.show_json(
            {
                "output": str(output),
                "duration_s": duration_s,
                "detection_count": summary.detection_count,
                "message_counts": summary.message_counts,
                **_text_fields(text),
            }
        )
        return
    console.show(
        f"{output}: {duration_s:.0f} s",
        console.pairs({f"  {topic}": f"{count} messages" for topic, count in summary.message_counts.items()}),
        f"  {summary.detection_count} objects detected",
        *_text_lines(text, duration_s),
    )


def _text_fields(text: TextLogSummary | None) -> dict[str, object]:
    if text is None:
        return {}
    return {
        "odometry_format": text.odometry_format,
        "odometry_length_m": text.odometry_length_m,
        "columns_left_out": list(text.columns_left_out),
        "notes": list(text.notes),
    }


def _text_lines(text: TextLogSummary | None, duration_s: float) -> list[str]:
    if text is None:
        return []
    speed = f" ({text.odometry_length_m / duration_s:.2f} m/s)" if duration_s > 0.0 else ""
    left_out = [f"  columns left out: {', '.join(text.columns_left_out)}"] if text.columns_left_out else []
    return [
        f"  odometry in {text.odometry_format} format, {text.odometry_length_m:.0f} m{speed}",
        *left_out,
        *(f"  note: {note}" for note in text.notes),
    ]
