"""dslam benchmark descriptors, as it is typed."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from tests.tools.runs import Result, Run, assert_refused

SCENARIOS = ("self", "fewer objects", "added noise")
MEASURES = {"success", "deviation", "ceiling", "of_ceiling", "misplaced", "likeliest", "top_5", "query_ms"}


def benchmark(dslam: Run, *arguments: object) -> Result:
    return dslam("benchmark", "descriptors", "--queries", 5, "--seeds", 1, *arguments)


def write_world(folder: Path) -> tuple[object, ...]:
    """A street of 60 objects, as CSV files."""
    classes = ("tree", "lamp", "bench")
    rows = [f"{3 * i},{5 + i * i % 7 - 12 * (i % 2)},0.5,{classes[(7 * i // 3) % 3]},n{i}" for i in range(60)]
    (folder / "objects.csv").write_text("x_m,y_m,z_m,class,id\n" + "\n".join(rows) + "\n")
    (folder / "trajectory.csv").write_text("x_m,y_m\n30,0\n150,0\n")
    return ("--objects", folder / "objects.csv", "--trajectory", folder / "trajectory.csv")


@pytest.mark.slow
def test_json_has_every_measure_of_every_scenario(dslam: Run) -> None:
    result = benchmark(dslam, "--descriptor", "ring_likelihood", "--descriptor", "exhaustive search", "--json")
    assert (result.code, result.err) == (0, "")
    told = json.loads(result.out)
    assert (told["map"], told["objects"], told["classes"]) == ("street-grid", 699, 16)
    assert (told["queries"], told["seeds"], told["neighbours"]) == (5, 1, 6)
    assert set(told["build_s"]) == {"ring_likelihood", "exhaustive search"}
    cells = {(cell["method"], cell["scenario"]): cell for cell in told["cells"]}
    assert list(cells) == [
        (name, scenario) for name in ("ring_likelihood", "exhaustive search") for scenario in SCENARIOS
    ]
    for cell in cells.values():
        assert set(cell) == {"method", "scenario"} | MEASURES
    assert cells["ring_likelihood", "self"]["success"] == cells["ring_likelihood", "self"]["ceiling"] == 1.0
    assert cells["exhaustive search", "self"]["top_5"] is None


def test_a_table_for_people(dslam: Run) -> None:
    result = benchmark(dslam, "--descriptor", "onion")
    assert (result.code, result.err) == (0, "")
    assert "699 objects, 16 classes; 5 queries x 1 seeds, 6 nearest descriptors" in result.out
    assert "of ceiling %" in result.out
    lines = [line for line in result.out.splitlines() if line.startswith("onion")]
    assert [scenario in line for scenario, line in zip(SCENARIOS, lines, strict=True)] == [True] * 3
    assert "time to index the map: onion" in result.out


def test_a_map_of_one_s_own(dslam: Run, tmp_path: Path) -> None:
    files = write_world(tmp_path)
    result = benchmark(dslam, *files, "--descriptor", "ring_likelihood", "--neighbours", 7, "--json")
    assert result.code == 0, result.err
    told = json.loads(result.out)
    assert (told["map"], told["objects"], told["classes"], told["neighbours"]) == (tmp_path.name, 60, 3, 7)
    assert told["cells"][0]["ceiling"] == 1.0


@pytest.mark.parametrize("which", [0, 2])
def test_objects_and_trajectory_belong_together(dslam: Run, tmp_path: Path, which: int) -> None:
    files = write_world(tmp_path)
    assert_refused(benchmark(dslam, *files[which : which + 2]), "--objects", "--trajectory")


def test_what_cannot_be_is_refused(dslam: Run, tmp_path: Path) -> None:
    files = write_world(tmp_path)
    assert_refused(benchmark(dslam, "--descriptor", "rings"), "'rings'", "ring_likelihood")
    assert_refused(benchmark(dslam, "--neighbours", 0), "--neighbours")
    assert_refused(dslam("benchmark", "descriptors", "--queries", 0), "--queries")
    assert_refused(dslam("benchmark", "descriptors", "--seeds", 0), "--seeds")
    (tmp_path / "trajectory.csv").write_text("x_m,y_m\n9000,0\n9100,0\n")
    assert_refused(benchmark(dslam, *files, "--descriptor", "onion"), "no object", "30 m")
    assert_refused(benchmark(dslam, "--objects", tmp_path / "none.csv", *files[2:]), "none.csv")


def test_recall_in_maps_of_objects(dslam: Run, tmp_path: Path) -> None:
    _, objects, *_ = write_world(tmp_path)
    asked = ("benchmark", "recall", "--objects", objects, "--size", 50, "--classes", 1, "--classes", 3, "--queries", 2)
    result = dslam(*asked, "--descriptor", "random", "--json")
    assert (result.code, result.err) == (0, "")
    figures = json.loads(result.out)["figures"]
    assert [(each["descriptor"], each["objects"], each["classes"]) for each in figures] == [
        ("random", 50, 1),
        ("random", 50, 3),
    ]
    table = dslam(*asked, "--descriptor", "random", "--markdown").out.splitlines()
    assert [len(line.split("|")) for line in table if line.startswith("|")] == [13] * 4
    assert "places @1 %" in dslam(*asked, "--descriptor", "random").out
    assert_refused(dslam(*asked, "--descriptor", "rings"), "rings")
