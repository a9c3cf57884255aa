"""dslam benchmark descriptors, as it is typed."""

from pathlib import Path

from tests.tools.runs import Result, Run, assert_refused, assert_well

SCENARIOS = ("self", "fewer objects", "added noise")
MEASURES = {"success", "deviation", "misplaced", "likeliest", "query_ms", "build_s"}


def benchmark(dslam: Run, *arguments: object) -> Result:
    return dslam("benchmark", "descriptors", "--queries", 5, "--seeds", 1, *arguments)


def write_world(folder: Path) -> tuple[object, ...]:
    """A street of 60 objects, as CSV files."""
    classes = ("tree", "lamp", "bench")
    rows = [f"{3 * i},{5 + i * i % 7 - 12 * (i % 2)},0.5,{classes[(7 * i // 3) % 3]},n{i}" for i in range(60)]
    (folder / "objects.csv").write_text("x_m,y_m,z_m,class,id\n" + "\n".join(rows) + "\n")
    (folder / "trajectory.csv").write_text("x_m,y_m\n30,0\n150,0\n")
    return ("--objects", folder / "objects.csv", "--trajectory", folder / "trajectory.csv")


def test_a_map_of_one_s_own(dslam: Run, tmp_path: Path) -> None:
    files = write_world(tmp_path)
    result = benchmark(dslam, *files, "--descriptor", "descriptellation_lr", "--json")
    assert result.code == 0, result.err
    told = result.json
    assert (told["map"], told["objects"], told["classes"]) == (tmp_path.name, 60, 3)
    assert (told["queries"], told["seeds"]) == (5, 1)
    cells = {(cell["method"], cell["scenario"]): cell for cell in told["cells"]}
    assert list(cells) == [(name, scenario) for name in ("descriptellation_lr", "random") for scenario in SCENARIOS]
    assert all(set(cell) == {"method", "scenario"} | MEASURES for cell in cells.values())
    exact = cells["descriptellation_lr", "self"]
    assert [exact[name] for name in ("success", "deviation")] == [1.0, 0.0]


def test_what_cannot_be_is_refused(dslam: Run, tmp_path: Path) -> None:
    files = write_world(tmp_path)
    assert_refused(benchmark(dslam, "--descriptor", "rings"), "'rings'", "descriptellation_lr")
    (tmp_path / "trajectory.csv").write_text("x_m,y_m\n9000,0\n9100,0\n")
    assert_refused(benchmark(dslam, *files, "--descriptor", "descriptellation_lr"), "no object", "30 m")
    assert_refused(benchmark(dslam, "--objects", tmp_path / "none.csv", *files[2:]), "none.csv")


def test_contest_in_maps_of_objects(dslam: Run, tmp_path: Path) -> None:
    _, objects, *_ = write_world(tmp_path)
    asked = ("benchmark", "recall", "--objects", objects, "--size", 50, "--classes", 1, "--classes", 3, "--queries", 2)
    figures = assert_well(dslam(*asked, "--descriptor", "descriptellation_lr", "--json")).json["figures"]
    assert [(each["proposer"], each["map_objects"], each["map_classes"]) for each in figures] == [
        ("descriptellation_lr", 50, 1),
        ("random", 50, 1),
        ("descriptellation_lr", 50, 3),
        ("random", 50, 3),
    ]
    assert_refused(dslam(*asked, "--query", "speed=1"), "'speed=1'", "objects, missing")
