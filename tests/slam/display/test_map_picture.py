from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from matplotlib.image import imread

from logs.scene import CLASS_COLORS
from slam.common.errors import EvaluationError
from slam.display.map_layers import Layer, MapPicture, class_layers, strokes
from slam.display.map_picture import draw_map
from slam.evaluation.report.picture import FALSE_CLOSURE, TRUE_CLOSURE
from tests.slam.evaluation.drives import straight_path

PATH = straight_path(100)[:, :3, 3]
ESTIMATE = Layer("estimate", PATH, "#0b5cad", width=2.8)
TREE = Layer("tree", np.ones((1, 3)), CLASS_COLORS[0], size=7.0)


def test_same_picture_has_same_bytes(tmp_path: Path) -> None:
    for name in ("a.png", "b.png"):
        draw_map(tmp_path / name, MapPicture("a map", "path 99 m", [ESTIMATE, TREE]))
    assert (tmp_path / "a.png").read_bytes() == (tmp_path / "b.png").read_bytes()
    assert sorted(p.name for p in tmp_path.iterdir()) == ["a.png", "b.png"]
    assert imread(tmp_path / "a.png")[..., :3].std() > 0.05


def test_false_closures_are_red_and_cannot_be_overlooked(tmp_path: Path) -> None:
    ends = np.array([[[10.0, 20.0, 0.0], [90.0, -20.0, 0.0]]])
    red = []
    for color, width in ((TRUE_CLOSURE, 1.6), (FALSE_CLOSURE, 4.0)):
        draw_map(tmp_path / "a.png", MapPicture("", "", [ESTIMATE, strokes("closures", ends, color, width)]))
        pixels = imread(tmp_path / "a.png")[..., :3]
        red.append(int(((pixels[..., 0] > 0.95) & (pixels[..., 1:].max(axis=-1) < 0.05)).sum()))
    assert red[0] < 10
    assert red[1] > 2000


@pytest.mark.parametrize("layer", [ESTIMATE, TREE])
def test_little_to_draw(tmp_path: Path, layer: Layer) -> None:
    draw_map(tmp_path / "a.png", MapPicture("", "", [layer]))
    shape = imread(tmp_path / "a.png").shape
    assert shape[1] == 1600
    assert 600 <= shape[0] <= 1600


def test_nothing_to_draw_is_refused(tmp_path: Path) -> None:
    with pytest.raises(EvaluationError, match="no position"):
        draw_map(tmp_path / "a.png", MapPicture("", "", [*class_layers(np.zeros((0, 3)), ())]))
    assert list(tmp_path.iterdir()) == []


def test_most_frequent_classes_have_a_layer_each() -> None:
    labels = tuple(f"c{i:02d}" for i in range(20) for _ in range(1 + (i == 19)))
    layers = [*class_layers(np.ones((21, 3)), labels)]
    names = ["c19", *(f"c{i:02d}" for i in range(len(CLASS_COLORS) - 1)), "other"]
    assert [layer.name for layer in layers] == names
    assert [layer.count for layer in layers] == [2, *[1] * 11, 8]
    assert len({(layer.color, layer.marker) for layer in layers}) == len(layers)
