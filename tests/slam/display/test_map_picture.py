from pathlib import Path

import numpy as np
import pytest
from matplotlib.image import imread

from logs.scene import CLASS_COLORS
from slam.common.errors import EvaluationError
from slam.display.map_picture import MapPicture
from slam.evaluation.report.picture import FALSE_CLOSURE, TRUE_CLOSURE
from tests.slam.evaluation.drives import straight_path

PATH = straight_path(100)[:, :3, 3]


def of_path() -> MapPicture:
    picture = MapPicture("a map", "path 99 m")
    picture.add_line("estimate", PATH, "#0b5cad", 2.8)
    return picture


def test_same_picture_has_same_bytes(tmp_path: Path) -> None:
    for name in ("a.png", "b.png"):
        picture = of_path()
        picture.add_landmarks(np.ones((1, 3)), ["$tree$"])
        picture.save(tmp_path / name)
    assert (tmp_path / "a.png").read_bytes() == (tmp_path / "b.png").read_bytes()
    assert sorted(p.name for p in tmp_path.iterdir()) == ["a.png", "b.png"]
    assert imread(tmp_path / "a.png")[..., :3].std() > 0.05


def test_false_closures_are_red_and_cannot_be_overlooked(tmp_path: Path) -> None:
    ends = np.array([[[10.0, 20.0, 0.0], [90.0, -20.0, 0.0]]])
    red = []
    for color, width in ((TRUE_CLOSURE, 1.6), (FALSE_CLOSURE, 4.0)):
        picture = of_path()
        picture.add_strokes("closures", ends, color, width)
        picture.save(tmp_path / "a.png")
        pixels = imread(tmp_path / "a.png")[..., :3]
        red.append(int(((pixels[..., 0] > 0.95) & (pixels[..., 1:].max(axis=-1) < 0.05)).sum()))
    assert red[0] < 10
    assert red[1] > 2000


def test_one_landmark_or_a_straight_path_fills_a_picture(tmp_path: Path) -> None:
    single = MapPicture("", "")
    single.add_landmarks(np.ones((1, 3)), ["tree"])
    for picture in (single, of_path()):
        picture.save(tmp_path / "a.png")
        shape = imread(tmp_path / "a.png").shape
        assert shape[1] == 1600
        assert 600 <= shape[0] <= 1600


def test_nothing_to_draw_is_refused(tmp_path: Path) -> None:
    picture = MapPicture("", "")
    picture.add_landmarks(np.zeros((0, 3)), ())
    with pytest.raises(EvaluationError, match="no position"):
        picture.save(tmp_path / "a.png")
    assert list(tmp_path.iterdir()) == []


def test_most_frequent_classes_have_marks_of_their_own() -> None:
    picture = MapPicture("", "")
    picture.add_landmarks(np.ones((21, 3)), tuple(f"c{i:02d}" for i in range(20) for _ in range(1 + (i == 19))))
    (axes,) = picture.figure.axes
    others = [f"c{i:02d} (1)" for i in range(len(CLASS_COLORS) - 1)]
    assert [marks.get_label() for marks in axes.collections] == ["c19 (2)", *others, "other (8)"]
    looks = {(marks.get_facecolor().tobytes(), marks.get_paths()[0].vertices.tobytes()) for marks in axes.collections}
    assert len(looks) == len(axes.collections)
