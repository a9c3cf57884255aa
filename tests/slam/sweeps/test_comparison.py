"""Groups of drives side by side: which differences are marked."""

import numpy as np
import pytest
from scipy import stats

from slam.sweeps.comparison import NO_SPREAD, compare, note_of
from slam.sweeps.mapped_drive import MappedDrive
from tools.lab.tables import rows_of

ATE = "trajectory.ate_m"


def drive(ate_m: float | None, recall: float | None = None) -> MappedDrive:
    return MappedDrive({"trajectory": {"ate_m": ate_m}, "closures": {"recall": recall}})


def mark(first: list[float], second: list[float | None]) -> str:
    labels = ["a"] * len(first) + ["b"] * len(second)
    return str(compare(labels, [drive(value) for value in (*first, *second)]).loc[("b", ATE), "mark"])


def test_spreads_are_those_of_numpy_without_undefined_values() -> None:
    values = np.random.default_rng(0).normal(3.0, 2.0, 7)
    found = compare(["a"] * 8, [*map(drive, values.tolist()), drive(None)]).loc[("a", ATE)]
    assert found["mean"] == pytest.approx(values.mean())
    assert found["standard_deviation"] == pytest.approx(values.std(ddof=1))
    assert (found["least"], found["greatest"]) == (values.min(), values.max())
    assert (found["count"], found["run_count"]) == (7, 8)


@pytest.mark.parametrize(
    ("first", "second", "expected"),
    [
        ([1.0, 1.1, 0.9], [0.1, 0.2], "* better"),
        ([1.0], [9.0], ""),  # no spread to exceed
        ([1.0, 1.1, 0.9], [2.0], "* worse"),  # a single run, by the spread of the other group
        ([1.0, 1.1, 0.9], [1.3], ""),
        ([0.3, 0.3], [0.1 + 0.2] * 2, ""),  # rounding
        ([0.3, 0.3], [0.301] * 2, "* worse"),
        ([1.0, 1.0], [None, None], ""),
    ],
)
def test_only_differences_beyond_the_spread_are_marked(
    first: list[float], second: list[float | None], expected: str
) -> None:
    assert mark(first, second) == expected


def test_limit_is_that_of_student() -> None:
    # Both groups have a deviation of 0.1; Student's t of 4 degrees of freedom exceeds 2 deviations.
    limit = 0.1 * stats.t.ppf(0.975, 4) * np.sqrt(2.0 / 3.0)
    for factor, is_marked in ((0.99, False), (1.01, True)):
        assert bool(mark([1.0, 1.1, 0.9], [1.0 + factor * limit + off for off in (0.0, 0.1, -0.1)])) == is_marked


def test_table_has_a_row_for_each_group() -> None:
    runs = [drive(ate_m + 0.01 * seed, recall) for ate_m, recall in ((1.0, 0.5), (2.0, 0.9)) for seed in range(3)]
    spreads = compare(["a"] * 3 + ["b"] * 3 + ["c"], [*runs, drive(None)])
    first, second, third = rows_of(spreads)
    assert list(first)[:4] == ["runs", "ATE m", "least to greatest", "closures precision"]
    assert (first["runs"], first["ATE m"], first["least to greatest"]) == (
        "a (3 runs)",
        "1.010 ± 0.010",
        "1.000 to 1.020",
    )
    assert (second["ATE m"], second["closures recall"]) == ("2.010 ± 0.010 * worse", "0.900 ± 0.000 * better")
    assert set(third.values()) == {"c (1 runs)", "–"}
    assert note_of(spreads.loc[["c"]]) == NO_SPREAD
