"""dslam benchmark relocalization, as it is typed."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from tests.helpers.loop_drives import one_block
from tests.tools.runs import Run, assert_refused

FIGURES = {
    *(
        "kidnaps",
        "success_rate",
        "late_rate",
        "false_relocalization_rate",
        "not_found_rate",
        "median_distance_m",
        "p95_distance_m",
    ),
    *("median_seconds", "median_error_m", "p95_error_m", "median_error_deg", "p95_error_deg"),
    *("misplaced_rate", "success_in_map_rate", "kept_rate", "revoked_rate"),
}
CONDITIONS = {"seed", "noise", "changed", "thin", "max_travel_m"}
RESULT = {
    "reliability",
    "world",
    "tour_m",
    "landmarks",
    "map_ate_m",
    "load_s",
    "query_ms",
    "groups",
    "outcomes",
    "oracle",
    "oracle_rate",
}


@pytest.fixture
def files(tmp_path: Path) -> tuple[object, ...]:
    """120 m of a furnished street, as CSV files."""
    world = one_block().shortened(120.0)
    rows = [
        f"{x},{y},{z},{label},{name}"
        for (x, y, z), label, name in zip(world.positions.tolist(), world.labels, world.object_ids, strict=True)
    ]
    (tmp_path / "objects.csv").write_text("x_m,y_m,z_m,class,id\n" + "\n".join(rows) + "\n")
    (tmp_path / "trajectory.csv").write_text("x_m,y_m\n" + "\n".join(f"{x},{y}" for x, y in world.tour.tolist()) + "\n")
    return ("--objects", tmp_path / "objects.csv", "--trajectory", tmp_path / "trajectory.csv")


@pytest.mark.slow
def test_json_has_every_figure(dslam: Run, files: tuple[object, ...], tmp_path: Path) -> None:
    more = ("--kidnaps", 2, "--max-travel", 25, "--seed", 5, "--noise", 1.5, "--changed", 0.1, "--json")
    result = dslam("benchmark", "relocalization", *files, *more)
    assert (result.code, result.err) == (0, "")
    told = json.loads(result.out)
    assert set(told) == FIGURES | CONDITIONS | RESULT
    assert (told["seed"], told["noise"], told["changed"], told["max_travel_m"]) == (5, 1.5, 0.1, 25.0)
    assert (told["world"], told["kidnaps"], len(told["outcomes"])) == (tmp_path.name, 2, 2)
    rates = ("success_rate", "late_rate", "false_relocalization_rate", "not_found_rate")
    for group in (told, *told["groups"].values()):
        assert set(group) >= FIGURES
        assert group["kidnaps"] == 0 or sum(group[rate] for rate in rates) == pytest.approx(1.0)
    assert all(outcome["distance_m"] is None or outcome["distance_m"] <= 25.0 for outcome in told["outcomes"])


def test_what_cannot_be_is_refused(dslam: Run, files: tuple[object, ...], tmp_path: Path) -> None:
    command = ("benchmark", "relocalization", *files)
    for option, value in (
        *(("--kidnaps", 0), ("--seed", -1), ("--noise", -1), ("--noise", 11), ("--changed", 1.5)),
        *(("--changed", -0.1), ("--max-travel", 1), ("--jobs", 0)),
    ):
        assert_refused(dslam(*command, option, value), option)
    assert_refused(dslam(*command[:4]), "--trajectory")
    assert_refused(dslam(*command, "--set", "loop_closure.topk=3"), "loop_closure.top_k")
    (tmp_path / "trajectory.csv").write_text("x_m,y_m\n0,0\n0,0\n")
    assert_refused(dslam(*command), "tour")


@pytest.mark.parametrize(
    ("options", "told"),
    [
        (("--log", "x.mcap"), "--map-until"),
        (("--log", "x.mcap", "--map-until", 9, "--seed", 3), "--seed: not with --log"),
        (("--map", "m.mcap", "--thin", 2), "--thin: not with --map"),
        (("--map-until", 3), "--map-until: only with --log"),
    ],
)
def test_options_of_another_mode_are_refused(dslam: Run, options: tuple[object, ...], told: str) -> None:
    assert_refused(dslam("benchmark", "relocalization", *options), told)
