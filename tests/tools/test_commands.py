"""What the commands do when all is well."""

import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from logs.messages import LoopClosureRecord, Odometry
from logs.writer import LogWriter
from tests.tools.runs import Run, assert_well
from tools import console

pytestmark = pytest.mark.slow


def test_a_drive_is_simulated_mapped_and_looked_into(dslam: Run, tmp_path: Path) -> None:
    drive, output = tmp_path / "drive.mcap", tmp_path / "map.mcap"
    made = dslam("simulate", drive, "--seed", 2, "--length", 100, "--set", "sensor.dropout=0.2")
    assert made.code == 0
    assert "world street-grid seed 2" in made.text
    replayed = dslam("replay", drive, "-o", output, "--set", "keyframe.distance_m=3", "--set", "calibrate=false")
    assert_well(replayed)  # no progress where there is no terminal
    assert "confirmed" in replayed.out
    told = dslam("info", output, "--closures").text
    for text in (
        "changed_settings calibrate=false, keyframe.distance_m=3",
        "landmarks_confirmed",
        "map of another log",
    ):
        assert text in told


def test_info_lists_loop_closures(dslam: Run, tmp_path: Path) -> None:
    log = tmp_path / "log.mcap"
    with LogWriter(log) as writer:
        writer.write("/odom", Odometry(10**18, np.eye(4)), 10**18)
        for query in range(60):
            stage = "accepted" if query == 50 else "registration"
            record = LoopClosureRecord(
                10**18 + query * 10**9, query, 0, query == 50, stage, f"{query} of [tree] agree", score=np.inf
            )
            if query == 50:
                record = replace(record, log_likelihood_ratio=23.5, odometry_penalty=1.25)
            writer.write("/slam/closures", record, 10**18)
    out = dslam("info", log, "--closures").out
    assert "# of [tree] agree" in out
    listed = [line.split()[:3] for line in out.splitlines() if line.endswith(" of [tree] agree")]
    assert listed == [[str(query), "0", f"{query}.0"] for query in range(40)]
    assert "and 20 more" in out
    _, heading, row = dslam("info", log, "--keyframe", 50).out.splitlines()
    assert {"LLR", "penalty"} < set(heading.split())
    assert row.split()[3:6] == ["inf", "23.5", "1.25"]
    assert "no loop-closure candidate" in dslam("info", log, "--keyframe", 60).out
    every = dslam("info", log, "--json", "--closures").json["closure_candidates"]
    assert [candidate["query_keyframe_id"] for candidate in every] == list(range(60))
    assert (every[50]["time_s"], every[50]["accepted"], every[50]["score"]) == (50.0, True, None)


def test_a_narrow_terminal_loses_no_digit(dslam: Run, mapped: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    numbers = re.compile(r"\d+\.\d+(?!\S)")
    wide = dslam("evaluate", mapped).out
    for width in (20, 40):
        monkeypatch.setattr(console, "PIPE_WIDTH", width)
        narrow = dslam("evaluate", mapped).out
        assert sorted(numbers.findall(narrow)) == sorted(numbers.findall(wide))


def test_figures_as_text_leave_out_what_is_empty_and_shorten_long_lists() -> None:
    counts = {f"class {number}": number for number in range(45)}
    texts = console.texts({"length_m": 12.5, "origin": None, "notes": (), "class_counts": counts})
    assert list(texts) == ["length m", "class counts"]
    assert texts["length m"] == "12.5"
    assert texts["class counts"].endswith("class 39 39, and 5 more")
