"""dslam map."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from tools.arguments import check_outputs

if TYPE_CHECKING:
    from slam.localization.prior_map import PriorMap
    from slam.object_map.map_io import SavedMap

app = typer.Typer(help="Merge saved maps.", no_args_is_help=True)

Output = Annotated[Path, typer.Option("-o", "--output", metavar="NEW.mcap", help="The map to write.")]


@app.command()
def merge(
    map_logs: Annotated[
        list[Path], typer.Argument(metavar="MAP.mcap MAP.mcap ...", help="Two maps or more.", show_default=False)
    ],
    output: Output,
) -> None:
    """Merge several maps in the frame of the first one.

    Maps that drives made are joined where places of one are recognised in another, or else by the georeferences of
    both; imported maps by their georeferences.

    Example: dslam map merge monday_map.mcap tuesday_map.mcap -o town.mcap
    """
    if len(map_logs) < 2:
        raise typer.BadParameter("give at least two maps.")
    check_outputs([output], map_logs)
    from slam.localization.imported_map_editing import merge_imported_maps
    from slam.localization.prior_map import load_prior_map
    from slam.object_map.map_io import write_map
    from slam.place_recognition.imported_map import ImportedMap, save_imported_map
    from tools import console

    maps = [(path, load_prior_map(path)) for path in map_logs]
    imported = [known for _, known in maps if isinstance(known, ImportedMap)]
    if len(imported) == len(maps):
        whole = imported[0]
        for each in imported[1:]:
            whole = merge_imported_maps(whole, each)
        save_imported_map(output, whole)
        console.show(f"{output}: {len(whole)} landmarks of {sum(map(len, imported))}")
        return
    driven = [(path, known) for path, known in maps if not isinstance(known, ImportedMap)]
    if imported:
        raise typer.BadParameter(
            f"{_first_imported(maps)} is an imported map and {driven[0][0]} is not; map the drive again by "
            "'dslam replay LOG -o OUT.mcap --map IMPORTED.mcap'."
        )
    write_map(output, _merge_driven(driven))
    console.show(str(output))


def _first_imported(maps: list[tuple[Path, PriorMap]]) -> Path:
    from slam.place_recognition.imported_map import ImportedMap

    return next(path for path, known in maps if isinstance(known, ImportedMap))


def _merge_driven(maps: list[tuple[Path, SavedMap]]) -> SavedMap:
    from slam.common.errors import SavedMapError
    from slam.map_joining.merging import MergedMap, merge_maps
    from tools import console

    merged = merge_maps([known for _, known in maps])
    if not isinstance(merged, MergedMap):
        raise SavedMapError(
            f"no place of {', '.join(str(maps[number][0]) for number in merged)} is recognised in the other maps, and "
            "not all maps are georeferenced, so their relative poses are unknown"
        )
    for (path, _), recognised in list(zip(maps, merged.recognised, strict=True))[1:]:
        console.show(f"{path}: {f'{recognised} places recognised' if recognised else 'no place recognised'}")
    console.show(f"{merged.shared} landmarks in more than one map, {len(merged.saved.objects.ids)} in all")
    for sha256 in merged.repeated:
        console.show(
            f"warning: the drive with the input {sha256[:8]} is in more than one map, and counts more than once"
        )
    return merged.saved
