"""What Rerun's viewer draws of a mapped drive: screenshots without a screen, by a software renderer."""

from __future__ import annotations

import io
import shutil
import subprocess
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np
import pytest

from logs.reader import LogReader
from slam.common.errors import ViewerError
from slam.display.map_topics import PATH_COLOR
from slam.replay import replay
from tests.helpers.short_drives import drive, write_log

pytest.importorskip("rerun", reason="Rerun is an extra: pip install 'descriptellation-slam[view]'")
from PIL import Image
from rerun.experimental import ViewerClient

from slam.display import rerun_viewer
from slam.display.rerun_view import TIMELINE
from tools.cli import run

pytestmark = [
    pytest.mark.slow,
    pytest.mark.skipif(not list(Path("/usr/share/vulkan/icd.d").glob("*")), reason="needs a Vulkan driver"),
]
SETTLE_FRAMES = 2
PATIENCE_S = 60.0
PORT = "9877"


@pytest.fixture(scope="module")
def output(tmp_path_factory) -> Path:
    folder = tmp_path_factory.mktemp("rerun")
    replay(write_log(folder / "drive.mcap", drive()), folder / "map.mcap")
    return folder / "map.mcap"


@contextmanager
def opened(path: Path) -> Iterator[ViewerClient]:
    viewer = subprocess.Popen(
        [rerun_viewer._executable(), "--headless", "--bind", rerun_viewer.LOOPBACK, "--port", PORT]
    )
    try:
        client = connect()
        client.open(str(path))
        yield client
    finally:
        viewer.kill()
        viewer.wait()


def connect() -> ViewerClient:
    """To the viewer, once it answers."""
    deadline = time.monotonic() + PATIENCE_S
    while True:
        try:
            return ViewerClient.connect(f"rerun+http://{rerun_viewer.LOOPBACK}:{PORT}/proxy")
        except Exception:
            if time.monotonic() > deadline:
                raise
            time.sleep(0.1)


def screenshot(client: ViewerClient, at_ns: int, is_drawn: Callable[[np.ndarray], bool]) -> np.ndarray:
    """(H, W, 3) of the map at a time, once it ``is_drawn``: a busy machine loads a log for longer than a few pictures.

    After ``PATIENCE_S`` it is what there is.
    """
    deadline = time.monotonic() + PATIENCE_S
    while not (views := maps_of(client)) and time.monotonic() < deadline:
        time.sleep(0.1)
    client.set_time(TIMELINE, timestamp=np.datetime64(at_ns, "ns"), play_state="paused")
    for _ in range(SETTLE_FRAMES):
        client.take_screenshot(views[0])
    while True:
        png = client.take_screenshot(views[0])
        picture = np.asarray(Image.open(io.BytesIO(png)).convert("RGB")).astype(np.int64)
        if is_drawn(picture) or time.monotonic() > deadline:
            return picture


def maps_of(client: ViewerClient) -> list[str]:
    return [view.view_id for view in client.get_state().views if view.view_class == "3D"]


def pixels_of(picture: np.ndarray, color: tuple[float, ...]) -> int:
    distance = np.linalg.norm(picture - 255 * np.array(color[:3]), axis=2)
    return int(np.count_nonzero(distance < 90))


def times(path: Path) -> list[int]:
    with LogReader(path) as reader:
        (info,) = [info for info in reader.topics() if info.topic == "/odom"]
    first, last = info.first_log_time_ns, info.last_log_time_ns
    return [round(first + fraction * (last - first)) for fraction in (0.3, 0.6, 1.0)]


def colorful(picture: np.ndarray) -> int:
    """Pixels of a strong colour, which neither background nor grid have."""
    return int(np.count_nonzero(picture.max(axis=2) - picture.min(axis=2) > 60))


def test_the_view_of_a_drive_is_not_empty_at_any_time(output, tmp_path):
    recording = tmp_path / "drive.rrd"
    assert run(["view", str(output), "--save", str(recording)]) == 0
    with opened(recording) as client:
        shorter = 50
        for at_ns in times(output):
            picture = screenshot(client, at_ns, lambda drawn, least=shorter: pixels_of(drawn, PATH_COLOR) > least)
            path = pixels_of(picture, PATH_COLOR)
            assert path > shorter
            assert colorful(picture) > path + 50
            shorter = path


def test_a_log_that_was_not_mapped_is_refused(output, tmp_path, capsys):
    assert run(["view", str(output.parent / "drive.mcap"), "--save", str(tmp_path / "x.rrd")]) == 2
    assert "/slam/path" in capsys.readouterr().err


def test_a_viewer_that_cannot_start_is_told(monkeypatch):
    monkeypatch.setattr("slam.display.rerun_viewer._executable", lambda: shutil.which("false"))
    with pytest.raises(ViewerError, match="ended with code 1"):
        rerun_viewer.show_recording(Path("drive.rrd"))
