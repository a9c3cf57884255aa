"""What the tests of the command line share."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from logs.messages import ObjectDetections, Odometry
from logs.writer import LogWriter

ROOT = Path(__file__).resolve().parents[2]
SAMPLE = ROOT / "logs" / "samples" / "short_drive.mcap"


@dataclass(frozen=True)
class Result:
    code: int
    out: str
    err: str


Run = Callable[..., Result]


def assert_refused(result: Result, *told: str, code: int = 2) -> None:
    """One line on standard error that tells ``told``, and nothing on standard output."""
    assert result.code == code
    assert result.out == ""
    assert result.err.startswith("dslam: ")
    assert result.err.endswith("\n")
    assert result.err.count("\n") == 1
    for text in told:
        assert text in result.err


def write_log(
    path: Path, *, odometry: tuple[str, ...] = ("/odom",), detections: tuple[str, ...] = ("/objects",)
) -> Path:
    with LogWriter(path) as writer:
        for stamp_ns in range(0, 10**9, 10**8):
            for topic in odometry:
                writer.write(topic, Odometry(stamp_ns, np.eye(4)))
            for topic in detections:
                record = ObjectDetections(stamp_ns, "base_link", np.array([[5.0, 0.0, 0.0]]), ("tree",), np.ones(1))
                writer.write(topic, record)
    return path
