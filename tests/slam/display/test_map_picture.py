from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from matplotlib.image import imread

from logs.scene import CLASS_COLORS
from slam.common.errors import EvaluationError
from slam.display.map_layers import MapPicture, layers_of
from slam.display.map_picture import draw_map
from tests.slam.evaluation.drives import straight_path, winding_path


def full_picture() -> MapPicture:
    rng = np.random.default_rng(0)
    path = winding_path(300)[:, :3, 3]
    return MapPicture(
        estimate=path,
        odometry=1.02 * path,
        truth=path + 0.5,
        landmarks=path[::2] + rng.uniform(-9, 9, (150, 3)),
        labels=tuple(f"class {i}" for i in rng.integers(0, 20, 150)),
        closures=np.stack([path[:3], path[-3:]], axis=1),
        true_closures=np.stack([path[3:9], path[-9:-3]], axis=1),
        false_closures=np.stack([path[9:10], path[-99:-98]], axis=1),
        ate_m=0.5,
        odometry_ate_m=3.0,
    )


def test_same_picture_has_same_bytes(tmp_path: Path) -> None:
    for name in ("a.png", "b.png"):
        draw_map(tmp_path / name, full_picture())
    assert (tmp_path / "a.png").read_bytes() == (tmp_path / "b.png").read_bytes()
    assert sorted(p.name for p in tmp_path.iterdir()) == ["a.png", "b.png"]
    pixels = imread(tmp_path / "a.png")
    assert pixels.shape[1] == 1600
    assert pixels[..., :3].std() > 0.05


def test_false_closures_are_red_and_cannot_be_overlooked(tmp_path: Path) -> None:
    path = straight_path(100)[:, :3, 3]
    ends = np.array([[[10.0, 20.0, 0.0], [90.0, -20.0, 0.0]]])
    pictures = {
        "true": MapPicture(path, true_closures=ends),
        "false": MapPicture(path, false_closures=ends),
    }
    red = {}
    for name, picture in pictures.items():
        draw_map(tmp_path / f"{name}.png", picture)
        pixels = imread(tmp_path / f"{name}.png")[..., :3]
        red[name] = int(((pixels[..., 0] > 0.95) & (pixels[..., 1:].max(axis=-1) < 0.05)).sum())
    assert red["true"] < 10
    assert red["false"] > 2000


@pytest.mark.parametrize(
    "picture",
    [
        MapPicture(estimate=straight_path(9)[:, :3, 3]),
        MapPicture(estimate=np.zeros((0, 3)), landmarks=np.ones((1, 3)), labels=("tree",)),
    ],
)
def test_little_to_draw(tmp_path: Path, picture: MapPicture) -> None:
    draw_map(tmp_path / "a.png", picture)
    shape = imread(tmp_path / "a.png").shape
    assert shape[1] == 1600
    assert 600 <= shape[0] <= 1600


def test_nothing_to_draw_is_refused(tmp_path: Path) -> None:
    with pytest.raises(EvaluationError, match="no position"):
        draw_map(tmp_path / "a.png", MapPicture(estimate=np.zeros((0, 3))))
    assert list(tmp_path.iterdir()) == []


def test_most_frequent_classes_have_a_layer_each() -> None:
    labels = tuple(f"c{i:02d}" for i in range(20) for _ in range(1 + (i == 19)))
    layers = layers_of(MapPicture(np.zeros((0, 3)), landmarks=np.ones((21, 3)), labels=labels))
    names = ["c19", *(f"c{i:02d}" for i in range(len(CLASS_COLORS) - 1)), "other"]
    assert [layer.name for layer in layers] == names
    assert [layer.count for layer in layers] == [2, *[1] * 11, 8]
    assert len({(layer.color, layer.marker) for layer in layers}) == len(layers)
