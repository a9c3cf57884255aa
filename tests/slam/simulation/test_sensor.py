import numpy as np
import pytest

from slam.common.arrays import FloatArray
from slam.simulation.config import SensorConfig
from slam.simulation.sensor import Scan, in_view, scan_objects, unshadowed
from slam.simulation.simulation import CAUSES

CLASS_COUNT = 4
PERFECT = SensorConfig(
    dropout=0.0, false_positives_per_scan=0.0, misclassification=0.0, noise_base_m=0.0, noise_per_m=0.0, occlusion=False
)


Rngs = dict[str, np.random.Generator]


def _rngs(seed: int = 0) -> Rngs:
    return {cause: np.random.default_rng([seed, number]) for number, cause in enumerate(CAUSES)}


def _scan(positions: FloatArray, config: SensorConfig, rngs: Rngs | None = None) -> Scan:
    classes = np.arange(len(positions)) % CLASS_COUNT
    return scan_objects(positions, classes, CLASS_COUNT, config, rngs or _rngs())


def _ring(range_m: float) -> FloatArray:
    bearing = np.linspace(-3.1, 3.1, 4000)
    return np.stack([range_m * np.cos(bearing), range_m * np.sin(bearing), np.zeros(4000)], axis=1)


def _with(**changes: float | bool) -> SensorConfig:
    return SensorConfig.model_validate({**PERFECT.model_dump(), **changes})


def test_perfect_sensor_sees_everything_as_it_is_in_the_order_of_bearing() -> None:
    positions = np.array([[0.0, 5.0, 1.0], [-3.0, -0.1, 0.0], [4.0, 0.0, 0.0]])
    scan = _scan(positions, PERFECT)
    np.testing.assert_array_equal(scan.sources, [1, 2, 0])
    np.testing.assert_array_equal(scan.positions, positions[scan.sources])
    np.testing.assert_array_equal(scan.class_indices, scan.sources)


def test_range_and_field_of_view_limit_the_view() -> None:
    positions = np.array([[29.99, 0.0, 0.0], [30.01, 0.0, 0.0], [0.0, -29.99, 0.0], [0.0, 29.0, 10.0]])
    np.testing.assert_array_equal(in_view(positions, SensorConfig()), [True, False, True, False])
    bearings = np.deg2rad([0.0, 44.9, -44.9, 45.1, -45.1, 180.0])
    around = 10.0 * np.stack([np.cos(bearings), np.sin(bearings), 0.0 * bearings], axis=1)
    seen = in_view(around, SensorConfig(field_of_view_deg=90.0))
    np.testing.assert_array_equal(seen, [True, True, True, False, False, False])


HALF_ANGLE = float(np.arcsin(0.05))


@pytest.mark.parametrize(
    ("radius_m", "xy", "is_seen"),
    [
        pytest.param(
            0.5,
            [
                (10, 0),
                (20, 0),
                *((20 * np.cos(a * HALF_ANGLE), 20 * np.sin(a * HALF_ANGLE)) for a in (0.98, 1.02)),
                (-20, 0),
            ],
            [True, False, False, True, True],
            id="what is behind and nothing else",
        ),
        pytest.param(0.25, [(-5, 0.01), (-20, -0.01)], [True, False], id="over the cut of the bearing"),
        pytest.param(0.25, [(10, 0), (10.1, 0)], [True, True], id="not on one post"),
        pytest.param(0.25, [(0.1, 0), (10, 0), (0, 0)], [True, True, True], id="not by what is around the sensor"),
    ],
)
def test_objects_are_hidden(radius_m: float, xy: list[tuple[float, float]], is_seen: list[bool]) -> None:
    positions = np.column_stack([np.array(xy, float), np.zeros(len(xy))])
    assert unshadowed(positions, radius_m).tolist() == is_seen


def test_occlusion_and_dropout_can_be_switched_off() -> None:
    positions = np.array([[10.0, 0.0, 0.0], [20.0, 0.0, 0.0]])
    np.testing.assert_array_equal(_scan(positions, _with(occlusion=True)).sources, [0])
    assert len(_scan(positions, PERFECT).sources) == 2
    assert len(_scan(_ring(10.0), _with(dropout=0.25)).sources) / 4000 == pytest.approx(0.75, abs=0.03)


def test_wrong_labels_grow_linearly_with_the_range_and_are_spread_over_the_other_classes() -> None:
    for range_m in (3.0, 15.0, 30.0):
        scan = _scan(_ring(range_m * 0.9999), _with(misclassification=0.4))
        true_classes = scan.sources % CLASS_COUNT
        wrong = scan.class_indices != true_classes
        assert wrong.mean() == pytest.approx(0.4 * range_m / 30.0, abs=0.03)
        shift = (scan.class_indices - true_classes)[wrong] % CLASS_COUNT
        share = np.bincount(shift, minlength=CLASS_COUNT) / wrong.sum()
        np.testing.assert_allclose(share, [0.0, 1 / 3, 1 / 3, 1 / 3], atol=0.1)


def test_false_positives_are_poisson_and_even_over_the_view() -> None:
    config = _with(false_positives_per_scan=2.0, field_of_view_deg=120.0)
    rngs = _rngs()
    scans = [_scan(np.zeros((0, 3)), config, rngs) for _ in range(3000)]
    counts = np.array([len(scan.sources) for scan in scans])
    assert counts.mean() == pytest.approx(2.0, abs=0.13)
    assert all(np.all(scan.sources == -1) for scan in scans)
    positions = np.concatenate([scan.positions for scan in scans])
    range_m = np.hypot(positions[:, 0], positions[:, 1])
    bearing = np.arctan2(positions[:, 1], positions[:, 0])
    assert range_m.max() <= 30.0
    assert np.abs(bearing).max() <= np.deg2rad(60.0)
    # Even over the area: a quarter of it lies within half the range.
    assert np.mean(range_m < 15.0) == pytest.approx(0.25, abs=0.03)
    classes = np.concatenate([scan.class_indices for scan in scans])
    np.testing.assert_allclose(np.bincount(classes, minlength=CLASS_COUNT) / len(classes), 0.25, atol=0.03)


@pytest.mark.parametrize(
    "changes", [{"dropout": 0.0}, {"occlusion": False}, {"false_positives_per_scan": 0.0}, {"misclassification": 0.0}]
)
def test_switching_one_cause_off_leaves_the_others_numbers(changes: dict[str, float]) -> None:
    positions = np.random.default_rng(5).uniform(-25.0, 25.0, (60, 3)) * [1.0, 1.0, 0.0]
    full, reduced = SensorConfig(dropout=0.3), SensorConfig.model_validate({"dropout": 0.3, **changes})
    first, second = _rngs(3), _rngs(3)
    for _ in range(10):
        a, b = _scan(positions, full, first), _scan(positions, reduced, second)
        measured = {int(i): p for i, p in zip(b.sources, b.positions, strict=True) if i >= 0}
        both = [(p, measured[int(i)]) for i, p in zip(a.sources, a.positions, strict=True) if int(i) in measured]
        assert len(both) > 10
        for mine, other in both:
            np.testing.assert_array_equal(mine, other)
