"""A map without a trajectory: objects of a city's open data, in a file that is mapped into memory and not read."""

import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from pydantic_core import from_json
from scipy.spatial import cKDTree

from descriptors.descriptellation_lr.pair_index import PairIndex
from descriptors.registry import shipped_likelihood
from logs.errors import LogError
from logs.messages import ObjectMapRecord, ScenePoints
from logs.reader import LogReader
from logs.records import frozen
from logs.scene import class_colors
from logs.storage.arrays import read_arrays
from logs.storage.regular_file import AnyPath
from logs.writer import LogWriter
from slam.common.arrays import FloatArray, IntArray
from slam.common.errors import GeometryError, SavedMapError, SlamError
from slam.common.georeference import Georeference
from slam.object_map.map_io import FORMAT_VERSION, IMPORTED, METADATA, OBJECTS_TOPIC, POINTS_TOPIC, drive_of
from slam.place_recognition.place_search import PlaceSearch

MAKE_IT = "import it again by 'dslam import'"
_CHECKED = ("positions", "classes", "ids")
_LAYOUT = {"positions": ("f", 2), "classes": ("u", 1), "ids": ("S", 1), "pair_words": ("u", 2), "pair_ends": ("u", 2),
           "pair_lengths": ("f", 1), "pair_classes": ("u", 1)}  # fmt: skip


@frozen
class ImportedMap:
    """Objects and the index of their pairs.

    ``positions`` (N, 3) m, z up; ``classes`` (N,) in ``vocabulary``; ``ids`` (N,) of the source, UTF-8;
    ``sigma_m``: standard deviation of a coordinate. ``georeference``: None where the source tells none.
    """

    positions: FloatArray
    classes: NDArray[np.uint16]
    ids: NDArray[np.bytes_]
    vocabulary: tuple[str, ...]
    sigma_m: float
    pairs: PairIndex
    georeference: Georeference | None
    metadata: Mapping[str, str]

    def __len__(self) -> int:
        return len(self.classes)

    @property
    def drives(self) -> tuple[Mapping[str, str], ...]:
        """The source in the place of drives, as :class:`slam.object_map.map_io.SavedMap` has them."""
        return (drive_of(self.metadata),)

    def search(self) -> PlaceSearch:
        """The map made ready for queries: 0.5 s for a million objects."""
        return PlaceSearch(self.pairs, self.positions, self.classes.astype(np.int64), len(self.vocabulary))

    @property
    def objects(self) -> ObjectMapRecord:
        """All objects as confirmed landmarks without observations, in memory."""
        return self.landmarks(np.arange(len(self)))

    def landmarks(self, rows: IntArray, *, observations: int = 0) -> ObjectMapRecord:
        """Objects (K,) as confirmed landmarks with so many observations each."""
        return ObjectMapRecord.of_objects(
            np.char.decode(self.ids[rows], "utf-8").tolist(),
            self.positions[rows].astype(np.float64),
            self.classes[rows],
            self.vocabulary,
            sigma_m=self.sigma_m,
            observations=observations,
        )


def make_imported_map(
    positions: FloatArray,
    labels: Sequence[str],
    ids: Sequence[str],
    *,
    sigma_m: float,
    georeference: Georeference | None = None,
    source: Mapping[str, str] | None = None,
) -> ImportedMap:
    """Index the pairs of objects.

    Args:
        positions: (N, 3) m, z up.
        labels: (N,) classes.
        ids: (N,) names in the source.
        sigma_m: standard deviation of a coordinate of an object.
        georeference: of the frame of the positions.
        source: where they come from, as text.

    Raises:
        SavedMapError: fewer than four objects, or positions that cannot be metres in the plane of one map.
    """
    _check_positions(positions)
    vocabulary, classes = np.unique(np.array(labels), return_inverse=True)
    pairs = PairIndex(shipped_likelihood())
    pairs.add(positions, classes)
    return ImportedMap(
        positions=positions,
        classes=classes.astype(np.uint16),
        ids=np.char.encode(np.array(ids), "utf-8"),
        vocabulary=tuple(vocabulary.tolist()),
        sigma_m=sigma_m,
        pairs=pairs,
        georeference=georeference,
        metadata=dict(source or {}),
    )


def save_imported_map(path: Path, imported: ImportedMap, objects: ObjectMapRecord | None = None) -> None:
    """Write a map log with the arrays as attachments: NAME.part first, which is renamed when it is complete.

    Args:
        path: replaced if it is there.
        imported: the map.
        objects: the same objects with what drives observed of them; :func:`slam.library.read_map` reads these.

    Raises:
        LogError: it cannot be written.
    """
    about = {
        **imported.metadata,
        "format_version": FORMAT_VERSION,
        "kind": IMPORTED,
        "vocabulary": json.dumps(imported.vocabulary),
        "grid": json.dumps({"sigma_m": imported.sigma_m, "unit_m": imported.pairs.unit_m}),
    }
    if imported.georeference is not None:
        about["georeference"] = imported.georeference.to_json()
    with LogWriter(path, refusals=(LogError, SlamError)) as writer:
        writer.add_metadata(METADATA, about)
        if objects is not None:
            writer.write(OBJECTS_TOPIC, objects)
        stamp_ns, colors = objects.stamp_ns if objects else 0, class_colors(imported.classes.astype(np.int64))
        writer.write(POINTS_TOPIC, ScenePoints(stamp_ns, "map", imported.positions.astype(np.float64), colors))
        arrays: list[NDArray[Any]] = [imported.positions, imported.classes, imported.ids, *imported.pairs.arrays]
        for name, array in zip(_LAYOUT, arrays, strict=True):
            writer.add_array(name, array)


def load_imported_map(path: AnyPath) -> ImportedMap:
    """Open a map that :func:`save_imported_map` has written; its index stays in the file.

    Raises:
        LogError: no MCAP file.
        SavedMapError: it is damaged, of another format version, or no imported map.
    """
    with LogReader(path) as reader:
        about = reader.metadata().get(METADATA, {})
        if about.get("kind") != IMPORTED or about.get("format_version") != FORMAT_VERSION:
            raise SavedMapError(f"{path} is not an imported map of format version {FORMAT_VERSION}; {MAKE_IT}")
    try:
        return _assembled(about, read_arrays(Path(path), checked=_CHECKED))
    except LogError as error:
        raise SavedMapError(f"{error}; {MAKE_IT}") from error
    except (KeyError, ValueError, TypeError, IndexError, OverflowError, GeometryError) as error:
        raise SavedMapError(f"{path} is damaged ({error}); {MAKE_IT}") from error


def _assembled(about: Mapping[str, str], arrays: Mapping[str, NDArray[Any]]) -> ImportedMap:
    if not arrays.keys() >= _LAYOUT.keys():
        raise ValueError("it is of an earlier version")
    for name, (kinds, dimensions) in _LAYOUT.items():
        if arrays[name].dtype.kind not in kinds or arrays[name].ndim != dimensions:
            raise ValueError(f"its array {name} is of {arrays[name].dtype} and shape {arrays[name].shape}")
    grid = from_json(about["grid"])
    georeference = about.get("georeference")
    positions, classes, ids, *of_pairs = (arrays[name] for name in _LAYOUT)
    imported = ImportedMap(
        positions=positions,
        classes=classes,
        ids=ids,
        vocabulary=tuple(from_json(about["vocabulary"])),
        sigma_m=float(grid["sigma_m"]),
        pairs=PairIndex.of(shipped_likelihood(), float(grid["unit_m"]), *of_pairs),
        georeference=None if georeference is None else Georeference.from_json(georeference),
        metadata=about,
    )
    if (
        not len(positions) == len(classes) == len(ids)
        or imported.pairs.ends.max(initial=0) >= len(ids)
        or classes.max(initial=0) >= len(imported.vocabulary)
    ):
        raise ValueError("its arrays disagree on the number of objects or classes")
    return imported


def _check_positions(positions: FloatArray) -> None:
    """Refuse positions that cannot be metres in the plane of one map."""
    if len(positions) < 4:
        raise SavedMapError(f"{len(positions)} objects; a map for relocalization needs at least four")
    is_finite = np.isfinite(positions).all(axis=1)
    if not is_finite.all():
        raise SavedMapError(f"object {is_finite.argmin()} has no finite position")
    plane = positions[:, :2]
    extent_m = np.ptp(plane, axis=0).max()
    spacing_m = float(np.median(cKDTree(plane).query(plane, k=[2])[0]))
    if extent_m > 1e6:
        raise SavedMapError(f"the objects extend over {extent_m / 1000.0:.0f} km, too much for a plane; crop the map")
    if spacing_m < 0.01 and np.abs(plane).max() <= 180.0:
        raise SavedMapError(
            f"the objects are {spacing_m:.2g} m apart; name the columns lat and lon if these are degrees, else remove "
            "repeated objects"
        )
