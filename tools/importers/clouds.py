"""dslam import semantic-kitti, paris-lille, iqmulus and ply: labelled point clouds."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from tools.arguments import Json, NewLog, check_outputs
from tools.importers.maps import SURVEYED_SIGMA_M, NewMap, Origin, Sigma, make_map

if TYPE_CHECKING:
    from logs.clouds.map_of_cloud import CloudSummary

CloudFile = Annotated[Path, typer.Option(metavar="FILE", help="PLY with x, y, z, class and the number of the object.")]
AnyCloud = Annotated[
    Path, typer.Option(metavar="FILE", help="File with the fields x, y, z, class or label, and optionally instance.")
]
Names = Annotated[
    list[str] | None,
    typer.Option(
        "--name", metavar="NUMBER=CLASS", help="Number and name of a class; by default all classes but 0. Repeatable."
    ),
]

_LONGEST_NUMBER = 18
"""Digits of the number of a class, so that 64 bits hold it."""


def semantic_kitti(
    output: NewLog,
    sequence: Annotated[
        Path | None,
        typer.Option(metavar="FOLDER", help="A sequence: velodyne/, labels/, poses.txt, calib.txt and times.txt."),
    ] = None,
    scans: Annotated[
        Path | None, typer.Option(metavar="FOLDER", help="Folder of NNNNNN.bin, if not in --sequence.")
    ] = None,
    labels: Annotated[
        Path | None, typer.Option(metavar="FOLDER", help="Folder of NNNNNN.label, for example predictions.")
    ] = None,
    odometry: Annotated[
        Path | None, typer.Option(metavar="POSES", help="Poses of the left camera in KITTI's format.")
    ] = None,
    calib: Annotated[Path | None, typer.Option(metavar="FILE", help="KITTI's calib.txt.")] = None,
    times: Annotated[Path | None, typer.Option(metavar="FILE", help="KITTI's times.txt, seconds.")] = None,
    ground_truth: Annotated[
        Path | None, typer.Option(metavar="POSES", help="True poses of the left camera; for evaluation only.")
    ] = None,
    json: Json = False,
) -> None:
    """SemanticKITTI: objects of labelled LiDAR scans.

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
    from logs.clouds.semantic_kitti import read_semantic_kitti
    from tools import console
    from tools.importers.drives import write_drive

    sequence_files = read_semantic_kitti(
        scans=paths[0], labels=paths[1], odometry=paths[2], calib=paths[3], times=paths[4], ground_truth=ground_truth
    )
    with console.progress_bar("finding objects", "writing the log") as progress:
        records = sequence_files.records(progress=progress)
    write_drive(output, records, sequence_files.drive.source, json=json)


def urban(
    output: NewMap, file: CloudFile, origin: Origin = None, sigma: Sigma = SURVEYED_SIGMA_M, json: Json = False
) -> None:
    """A map of the objects of Paris-Lille-3D (the files of 50 classes) or of IQmulus & TerraMobilita.

    Movable and unknown objects, bollards and surfaces are left out, as in "Descriptellation" (Xing et al.);
    the numbers of objects and classes before and after are printed, as in its Table I.

    Example: dslam import paris-lille lille_map.mcap --file training_50_classes/Lille1.ply
    """
    check_outputs([output], [file])
    from logs.clouds.cloud_files import read_cloud
    from logs.clouds.map_of_cloud import urban_objects
    from logs.digest import file_sha256

    objects, summary = urban_objects(read_cloud(file), str(file), file_sha256(file))
    make_map(output, objects, origin, None, sigma, json=json, more={**_statistics(summary), **_left_out(summary)})


def ply(
    output: NewMap,
    file: AnyCloud,
    name: Names = None,
    origin: Origin = None,
    sigma: Sigma = SURVEYED_SIGMA_M,
    json: Json = False,
) -> None:
    """A map of the objects of any labelled cloud of a whole place, from a PLY file.

    Example: dslam import ply town_map.mcap --file town.ply --name 80=pole --name 71=trunk
    """
    check_outputs([output], [file])
    from logs.clouds.cloud_files import read_cloud
    from logs.clouds.map_of_cloud import named_objects
    from logs.digest import file_sha256

    objects, summary = named_objects(read_cloud(file), str(file), file_sha256(file), _parsed_names(name))
    make_map(output, objects, origin, None, sigma, json=json, more=_left_out(summary))


def _parsed_names(names: list[str] | None) -> Mapping[int, str] | None:
    named: dict[int, str] = {}
    for pair in names or ():
        number, _, label = pair.partition("=")
        if not number.isdecimal() or len(number) > _LONGEST_NUMBER or not label:
            raise typer.BadParameter(f"{pair!r} is not NUMBER=CLASS, for example 80=pole.", param_hint="--name")
        named[int(number)] = label
    return named or None


def _statistics(summary: CloudSummary) -> dict[str, object]:
    """Table I of the paper, a line each."""
    (objects, classes), (objects_left, classes_left) = summary.original, summary.preprocessed
    return {
        "original": f"{objects} objects, {classes} classes",
        "preprocessed": f"{objects_left} objects, {classes_left} classes",
    }


def _left_out(summary: CloudSummary) -> dict[str, object]:
    return {"left out": ", ".join(f"{count} {why}" for why, count in sorted(summary.left_out.items())) or "none"}
