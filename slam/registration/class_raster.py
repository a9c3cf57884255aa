"""The nearest map object of a class for many points at once: a raster that is looked up instead of a tree."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from slam.common.arrays import ComplexArray, FloatArray, IntArray
from slam.common.errors import GeometryError

BITS = 4
SIDE = 2**BITS
"""Cells along the edge of a block, and blocks along that of a region; only those an object reaches are stored."""
INSIDE = SIDE - 1
"""The bits of a column or row that say where in its block a cell is, or where in its region a block."""
MAX_REGIONS = 2**26
"""Of all classes together: what a quarter of a gigabyte lists."""


@dataclass(frozen=True, slots=True, eq=False)
class ClassRaster:
    """For each class a grid of cells that name the object of that class nearest to the cell's centre.

    ``cell_m`` is the edge of a cell. A look-up is exact for an object whose distance and a cell's diagonal together are
    less than half the distance of that object to the next one of its class.
    """

    cell_m: float
    corner: FloatArray
    """(C, 2) m: the lower corner of each class's grid."""
    shape: IntArray
    """(C, 2) regions; no object reaches the first and the last row and column of cells."""
    start: IntArray
    """(C + 1,) where the regions of a class start in ``regions``."""
    regions: NDArray[np.int32]
    """(R,) where the blocks of a region start in ``blocks``; 0, an empty one, where there is none."""
    blocks: NDArray[np.int32]
    """(B,) where the cells of a block start in ``cells``; 0, an empty one, where there is none."""
    cells: NDArray[np.int32]
    """(K,) an object, or the number of objects where none is within reach."""

    def nearest(self, label: int, at: ComplexArray) -> NDArray[np.int32]:
        """The object (H,) of class ``label`` nearest to each of ``at`` (H,) m, x + iy; or the number of objects."""
        last_column, last_row = (self.shape[label] * SIDE**2 - 1.0).tolist()
        x, y = (self.corner[label] / self.cell_m).tolist()
        column = _cell(at.real, x, last_column, self.cell_m)
        row = _cell(at.imag, y, last_row, self.cell_m)
        region = column >> (2 * BITS)
        region *= int(self.shape[label, 1])
        region += row >> (2 * BITS)
        region += int(self.start[label])
        block = _inside(column >> BITS, row >> BITS)
        block += self.regions.take(region)
        cell = _inside(column, row)
        cell += self.blocks.take(block)
        return np.asarray(self.cells.take(cell))


def _cell(coordinates: FloatArray, corner: float, last: float, cell_m: float) -> IntArray:
    """The columns or rows (H,) in which coordinates (H,) m lie; all outside are in the first or ``last``, empty ones.

    ``corner`` is in cells.
    """
    scaled = coordinates * (1.0 / cell_m)
    scaled -= corner
    np.maximum(scaled, 0.0, out=scaled)
    np.minimum(scaled, last, out=scaled)
    return np.asarray(scaled.astype(np.int64))


def _inside(column: IntArray, row: IntArray) -> IntArray:
    """Where in its block a cell is, or where in its region a block."""
    place = column & INSIDE
    place <<= BITS
    place += row & INSIDE
    return np.asarray(place)


def make_class_raster(
    planar: FloatArray, labels: IntArray, classes: int, *, reach_m: float, cell_m: float
) -> ClassRaster:
    """The raster of objects (M, 2) m with labels (M,) in 0 .. ``classes`` - 1, each of which occurs.

    Raises:
        GeometryError: objects so far apart that the list of regions would not fit into memory.
    """
    lower, upper = np.full((classes, 2), np.inf), np.full((classes, 2), -np.inf)
    np.minimum.at(lower, labels, planar)
    np.maximum.at(upper, labels, planar)
    margin_m = reach_m + 3.0 * cell_m
    corner = lower - margin_m
    extents = np.floor((upper + margin_m - corner) / (cell_m * SIDE**2)) + 1.0
    count = float(extents.prod(axis=1).sum())
    if count > MAX_REGIONS:
        raise GeometryError(
            f"{len(planar)} objects over {(upper - lower).max() / 1e3:.0f} km: a raster of {cell_m:g} m has "
            f"{count:.2g} regions, more than {MAX_REGIONS}; leave out the objects that lie apart, or divide the map"
        )
    shape = extents.astype(np.int64)
    start = np.concatenate([[0], np.cumsum(shape[:, 0] * shape[:, 1])])
    own = np.floor((planar - corner[labels]) / cell_m).astype(np.int64)
    half = int(np.ceil(reach_m / cell_m)) + 1
    # From end to end in steps of a block at the most, so that no block is left out.
    steps = np.append(np.arange(-half, half, SIDE), half)
    column, row = (own[:, None] + np.stack(np.meshgrid(steps, steps), axis=-1).reshape(-1, 2)).reshape(-1, 2).T
    label = np.repeat(labels, len(steps) ** 2)
    region = start[label] + (column >> (2 * BITS)) * shape[label, 1] + (row >> (2 * BITS))
    regions, blocks_stored = _stored(region, int(start[-1]))
    blocks, cells_stored = _stored(regions[region] + _inside(column >> BITS, row >> BITS), blocks_stored)
    cells = np.full(cells_stored, len(planar), dtype=np.int32)
    raster = ClassRaster(cell_m, corner, shape, start, regions, blocks, cells)
    _enter(raster, planar, labels, own, reach_m)
    return raster


def _stored(places: IntArray, count: int) -> tuple[NDArray[np.int32], int]:
    """Where the contents of each of ``count`` places start, one level below, and the size of that level.

    Only those of ``places`` have any; all others start at 0, where nothing is.
    """
    occupied = np.unique(places)
    listed = np.zeros(count, dtype=np.int32)
    listed[occupied] = (np.arange(len(occupied)) + 1) * SIDE**2
    return listed, (len(occupied) + 1) * SIDE**2


def _enter(raster: ClassRaster, planar: FloatArray, labels: IntArray, own: IntArray, reach_m: float) -> None:
    """Write each object (M, 2), which lies in the cell ``own`` (M, 2), into the cells it is the nearest one of."""
    half = int(np.ceil(reach_m / raster.cell_m)) + 1
    side = np.arange(-half, half + 1)
    # A cell wider than the reach, as objects are anywhere in their own cells.
    disc = np.argwhere(np.hypot(side[:, None], side) <= reach_m / raster.cell_m + 1.0) - half
    within = planar - raster.corner[labels] - (own + 0.5) * raster.cell_m
    nearest_m = np.full(len(raster.cells), reach_m, dtype=np.float32)
    for offset in disc:
        column, row = (own + offset).T
        region = raster.start[labels] + (column >> (2 * BITS)) * raster.shape[labels, 1] + (row >> (2 * BITS))
        block = raster.regions[region] + _inside(column >> BITS, row >> BITS)
        cell = raster.blocks[block] + _inside(column, row)
        away = offset * raster.cell_m - within
        distance_m = np.hypot(away[:, 0], away[:, 1]).astype(np.float32)
        closer = np.flatnonzero(distance_m < nearest_m[cell])
        # Of two objects in one cell one overwrites the other, which then has another try.
        while len(closer):
            nearest_m[cell[closer]] = distance_m[closer]
            raster.cells[cell[closer]] = closer
            closer = closer[distance_m[closer] < nearest_m[cell[closer]]]
