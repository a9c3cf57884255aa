"""Imported maps: their file, and what is refused."""

from pathlib import Path

import numpy as np
import pytest

from slam.common.arrays import FloatArray
from slam.common.errors import SavedMapError
from slam.common.georeference import Georeference
from slam.localization.prior_map import load_prior_map
from slam.place_recognition.imported_map import ImportedMap, make_imported_map, save_imported_map


def scattered(count: int = 500) -> FloatArray:
    rng = np.random.default_rng(4)
    return np.column_stack([rng.uniform(-100.0, 300.0, (count, 2)), np.zeros(count)])


def imported(positions: FloatArray) -> ImportedMap:
    labels = ["pole", "tree"] * (len(positions) // 2) + ["pole"] * (len(positions) % 2)
    ids = [f"n{row}" for row in range(len(positions))]
    return make_imported_map(positions, labels, ids, sigma_m=0.3, georeference=Georeference(60.0, 24.0))


@pytest.fixture
def known() -> ImportedMap:
    return imported(scattered())


@pytest.fixture
def path(known: ImportedMap, tmp_path: Path) -> Path:
    save_imported_map(tmp_path / "map.mcap", known)
    return tmp_path / "map.mcap"


def test_a_file_gives_it_back(known: ImportedMap, path: Path) -> None:
    loaded = load_prior_map(path)
    assert isinstance(loaded, ImportedMap)
    assert isinstance(loaded.pairs.words, np.memmap)
    assert (loaded.vocabulary, loaded.georeference, loaded.sigma_m) == (("pole", "tree"), known.georeference, 0.3)
    for name in ("positions", "classes", "ids"):
        np.testing.assert_array_equal(getattr(loaded, name), getattr(known, name))
    again = path.with_name("again.mcap")
    save_imported_map(again, known)
    assert again.read_bytes() == path.read_bytes()


def test_a_damaged_file_is_refused(known: ImportedMap, path: Path) -> None:
    content = bytearray(path.read_bytes())
    content[content.index(known.positions.tobytes()) + 7] ^= 1
    for damaged in (content, content[: len(content) // 2]):
        path.write_bytes(damaged)
        with pytest.raises(SavedMapError, match=r"map\.mcap.*damaged"):
            load_prior_map(path)


@pytest.mark.parametrize(
    ("positions", "fault"),
    [
        (scattered() * 1e-6 + [24.9, 60.1, 0.0], "name the columns lat and lon"),
        (scattered(3), "3 objects"),
        (scattered() * 1e5, "too much for a plane"),
        (np.where(np.arange(1500).reshape(500, 3) == 7, np.nan, 1.0) * scattered(), "object 2 has no finite"),
    ],
)
def test_positions_that_are_none(positions: FloatArray, fault: str) -> None:
    with pytest.raises(SavedMapError, match=fault):
        imported(positions)
