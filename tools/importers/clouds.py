"""dslam import ply: labelled point clouds."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Annotated

import typer

from tools.arguments import Json, check_outputs
from tools.importers.maps import SURVEYED_SIGMA_M, NewMap, Origin, Sigma, make_map

Cloud = Annotated[
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


def ply(
    output: NewMap,
    file: Cloud,
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
    from logs.clouds.map_of_cloud import map_of_cloud
    from logs.digest import file_sha256

    objects = map_of_cloud(read_cloud(file), str(file), file_sha256(file), _parsed_names(name))
    make_map(output, objects, origin, None, sigma, json=json)


def _parsed_names(names: list[str] | None) -> Mapping[int, str] | None:
    named: dict[int, str] = {}
    for pair in names or ():
        number, _, label = pair.partition("=")
        if not number.isdecimal() or len(number) > _LONGEST_NUMBER or not label:
            raise typer.BadParameter(f"{pair!r} is not NUMBER=CLASS, for example 80=pole.", param_hint="--name")
        named[int(number)] = label
    return named or None
