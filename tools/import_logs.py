"""dslam import."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from tools.arguments import Json, NewLog, check_outputs

if TYPE_CHECKING:
    from logs.importers.imported_log import ImportSummary

app = typer.Typer(help="Turn data of others into a log that 'dslam replay' reads.", no_args_is_help=True)


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

    _tell(
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

    _tell(output, import_victoria_park(output, path=file), json=json)


def _tell(output: Path, summary: ImportSummary, *, json: bool) -> None:
    from tools import console

    duration_s = ((summary.last_stamp_ns or 0) - (summary.first_stamp_ns or 0)) * 1e-9
    if json:
        console.show_json(
            {
                "output": str(output),
                "duration_s": duration_s,
                "detection_count": summary.detection_count,
                "message_counts": summary.message_counts,
            }
        )
        return
    console.show(
        f"{output}: {duration_s:.0f} s",
        console.pairs({f"  {topic}": f"{count} messages" for topic, count in summary.message_counts.items()}),
        f"  {summary.detection_count} objects detected",
    )
