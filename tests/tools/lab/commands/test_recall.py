"""dslam benchmark recall, as it is typed."""

from __future__ import annotations

import json
from pathlib import Path

import pandas as pd

from tests.tools.runs import Run, assert_refused


def test_contest_in_maps_of_objects(dslam: Run, tmp_path: Path) -> None:
    objects, classes = tmp_path / "objects.csv", ("tree", "lamp", "bench")
    rows = [f"{3 * i},{5 + i * i % 7 - 12 * (i % 2)},0.5,{classes[(7 * i // 3) % 3]}\n" for i in range(60)]
    objects.write_text("x_m,y_m,z_m,class\n" + "".join(rows))
    asked = ("benchmark", "recall", "--objects", objects, "--size", 50, "--classes", 1, "--classes", 3, "--queries", 2)
    result = dslam(*asked, "--descriptor", "descriptellation_lr", "--json")
    assert (result.code, result.err) == (0, "")
    figures = json.loads(result.out)["figures"]
    assert [(each["proposer"], each["map_objects"], each["map_classes"]) for each in figures] == [
        ("descriptellation_lr", 50, 1),
        ("random", 50, 1),
        ("descriptellation_lr", 50, 3),
        ("random", 50, 3),
    ]
    queries = ("--query", "objects=10", "--query", "objects=10,missing=0.2")
    asking = (*asked, "--descriptor", "descriptellation_lr", *queries, "--markdown", "-o", tmp_path)
    again = dslam(*asking)
    rows = [line.split(" | ")[:3] for line in again.out.splitlines() if line.startswith("| descriptellation_lr")]
    assert [row[2] for row in rows if row[1] == "50 of 1"][1] == "objects=10,missing=0.2"
    assert again.out.count("| random |") == 2  # random vectors in each map, with the first query
    before = pd.read_csv(tmp_path / "contest.csv")
    dslam(*asking)
    added = pd.read_csv(tmp_path / "contest.csv")
    assert added["at_1"].tolist() == 2 * before["at_1"].tolist()
    assert_refused(dslam(*asked, "--descriptor", "rings"), "rings")
    for wrong in ("objects", "objects=few", "missing=1", "speed=1"):
        assert_refused(dslam(*asked, "--query", wrong), repr(wrong), "objects, missing")
