"""Places that a robot is kidnapped to, and what changed there in the meantime."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from slam.common.errors import SimulationError
from slam.simulation.config import SensorConfig
from tests.helpers.loop_drives import one_block
from tools.lab.relocalization.kidnaps import change_world, draw_kidnaps, thin_world, worsen


def rng() -> np.random.Generator:
    return np.random.default_rng(1)


def test_places_are_pieces_of_the_tour_in_either_direction():
    block = one_block()
    kidnaps = draw_kidnaps(block.tour, count=20, length_m=30.0, rng=rng())
    assert {kidnap.is_along for kidnap in kidnaps} == {True, False}
    for kidnap in kidnaps:
        assert np.linalg.norm(np.diff(kidnap.tour, axis=0), axis=1).sum() == pytest.approx(30.0)


def test_places_that_cannot_be_are_refused():
    tour = one_block().tour
    for count, length_m, given in ((0, 50.0, tour), (3, 0.0, tour), (3, 50.0, np.zeros((4, 2)))):
        with pytest.raises(SimulationError, match="above 0"):
            draw_kidnaps(given, count=count, length_m=length_m, rng=rng())


def test_share_of_the_objects_near_the_tour_is_replaced_and_the_others_stay():
    block = one_block()
    far = replace(
        block,
        object_ids=(*block.object_ids, "far"),
        positions=np.vstack([block.positions, [900.0, 900.0, 0.0]]),
        labels=(*block.labels, "tower"),
    )
    changed = change_world(far, 0.25, reach_m=30.0, rng=rng())
    new = set(changed.object_ids) - set(far.object_ids)
    assert len(new) == round(0.25 * len(block.object_ids)) == len(set(far.object_ids) - set(changed.object_ids))
    assert "far" in changed.object_ids
    where = dict(zip(far.object_ids, zip(far.labels, far.positions.tolist(), strict=True), strict=True))
    for name, label, position in zip(changed.object_ids, changed.labels, changed.positions.tolist(), strict=True):
        assert name in new or where[name] == (label, position)
    assert change_world(far, 0.0, reach_m=30.0, rng=rng()) is far
    for share in (-0.1, 1.1, np.nan):
        with pytest.raises(SimulationError, match="0 to 1"):
            change_world(far, share, reach_m=30.0, rng=rng())


def test_thinned_world_has_one_of_so_many_objects():
    block = one_block()
    thin = thin_world(block, 5.0, rng=rng())
    assert len(thin.labels) == round(len(block.labels) / 5.0)
    assert set(thin.object_ids) < set(block.object_ids)
    assert thin_world(block, 1.0, rng=rng()) is block
    assert len(thin_world(block, 1e6, rng=rng()).labels) == 1
    with pytest.raises(SimulationError, match="factor of at least 1"):
        thin_world(block, 0.5, rng=rng())


def test_worse_sensor_has_larger_errors_and_probabilities_stay_below_one():
    sensor = SensorConfig()
    twice, far_worse = worsen(sensor, 2.0), worsen(sensor, 50.0)
    errors = ("noise_base_m", "noise_per_m", "dropout", "false_positives_per_scan", "misclassification")
    assert [getattr(twice, name) for name in errors] == [2.0 * getattr(sensor, name) for name in errors]
    assert (far_worse.dropout, far_worse.misclassification) == (1.0, 1.0)
    assert twice.max_range_m == sensor.max_range_m
