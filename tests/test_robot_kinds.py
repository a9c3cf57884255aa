"""The script that makes drives of many kinds of robots."""

import runpy
from pathlib import Path

import numpy as np
import pytest

from logs.reader import LogReader
from tools.lab.drives.robot_drives import find_drives, import_drive

KINDS = runpy.run_path(str(Path(__file__).resolve().parents[1] / "docs" / "robot_kinds.py"))


@pytest.mark.parametrize("name", KINDS["KINDS"])
def test_every_kind_of_robot_drives_among_its_objects(name):
    kind = KINDS["KINDS"][name](np.random.default_rng(0))
    assert len(kind.labels) == len(kind.objects)
    assert kind.objects.shape[1] == 3
    low, high = kind.way[:, :2].min(axis=0) - kind.range_m, kind.way[:, :2].max(axis=0) + kind.range_m
    near = np.all((kind.objects[:, :2] > low) & (kind.objects[:, :2] < high), axis=1)
    assert near.mean() > 0.5


@pytest.mark.slow
def test_a_drive_is_written_as_it_is_imported(tmp_path):
    KINDS["write"](tmp_path / "office", "office, tags")
    (folder,) = find_drives(tmp_path).values()
    import_drive(folder, tmp_path / "drive.mcap")
    with LogReader(tmp_path / "drive.mcap") as reader:
        counts = {info.topic: info.message_count for info in reader.topics()}
    assert {"/odom", "/detections", "/ground_truth"} <= counts.keys()
    assert sum(counts.values()) > 1000
