"""The public library: every name of it, and its examples."""

import ast
from pathlib import Path

import numpy as np
import pytest

import dslam
from dslam import ImportedMap, InputDataError, landmark_table, load_map, read_map, read_trajectory, save_map
from slam.place_recognition.imported_map import make_imported_map
from tests.tools.runs import SAMPLE, text_of


def test_every_public_name_is_typed_and_found() -> None:
    tree = ast.parse(text_of("dslam.py"))
    typed = {
        name.asname or name.name
        for block in tree.body
        if isinstance(block, ast.If)
        for node in ast.walk(block)
        if isinstance(node, ast.ImportFrom)
        for name in node.names
    }
    assert set(dslam.__all__) == typed - {"main"}
    assert all(getattr(dslam, name).__doc__ for name in dslam.__all__)
    with pytest.raises(AttributeError, match="no attribute 'nothing'"):
        _ = dslam.nothing


def test_a_log_without_a_map_is_refused() -> None:
    with pytest.raises(InputDataError, match="holds no map"):
        read_map(SAMPLE)
    with pytest.raises(InputDataError, match="holds no trajectory"):
        read_trajectory(SAMPLE)


def test_maps_of_both_kinds_are_loaded_saved_and_read(tmp_path: Path) -> None:
    positions = np.array([[0.0, 0.0, 0.0], [5.0, 0.0, 0.0], [0.0, 7.0, 0.0], [6.0, 8.0, 1.0]])
    labels = ["tree", "pole", "tree", "tree"]
    made = make_imported_map(positions, labels, list("abcd"), sigma_m=0.2)
    save_map(str(tmp_path / "imported.mcap"), made)
    loaded = load_map(str(tmp_path / "imported.mcap"))
    assert isinstance(loaded, ImportedMap)
    objects = read_map(tmp_path / "imported.mcap")
    rows = sorted(zip(objects.ids, objects.labels, objects.positions.tolist(), strict=True))
    assert rows == list(zip("abcd", labels, positions.tolist(), strict=True))
    np.testing.assert_allclose(landmark_table(objects)["sigma_x_m"], 0.2)
    assert len(dslam.__version__.split(".")) == 3
