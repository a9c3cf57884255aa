from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from logs.messages import ObjectMapRecord
from logs.reader import LogReader
from logs.selection import Selection
from logs.topics import RecordKind
from tests.helpers.driven_maps import town
from tools.lab.fleets.simulated_fleet import FleetPlan, SimulatedFleet, simulate_fleet

PLAN = FleetPlan(drives=8, length_m=20.0, area_m=60.0, months=4, bad=0.3)


@pytest.fixture(scope="module")
def fleet(tmp_path_factory: pytest.TempPathFactory) -> SimulatedFleet:
    world = town()
    near = np.flatnonzero(np.hypot(*(world.positions[:, :2] - world.tour[0]).T) < 80.0)
    small = replace(
        world,
        object_ids=tuple(world.object_ids[row] for row in near),
        positions=world.positions[near],
        labels=tuple(world.labels[row] for row in near),
    )
    return simulate_fleet(tmp_path_factory.mktemp("fleet"), [small], PLAN, seed=3)


def test_a_tenth_of_the_objects_changes_each_month(fleet: SimulatedFleet) -> None:
    (objects,) = fleet.objects
    for month in range(1, PLAN.months):
        # A third of what changes goes, a third moves, which ends the old object, and a third comes.
        count = 2 * round(PLAN.changed * (objects["came"] == 0).sum() / 3.0)
        assert (objects["went"] == month).sum() == (objects["came"] == month).sum() == count > 0


def test_drives_see_the_objects_of_their_month(fleet: SimulatedFleet) -> None:
    (objects,) = fleet.objects
    for log in fleet.logs:
        drive = fleet.drives[log.sha256]
        if drive.city == 0:
            with LogReader(log.path) as reader:
                (entry,) = reader.records(Selection({"/ground_truth/objects": (RecordKind.OBJECT_MAP,)}))
            assert isinstance(entry.record, ObjectMapRecord)
            is_there = (objects["came"] <= drive.month) & ~(objects["went"] <= drive.month)
            assert set(entry.record.ids) == set(objects.index[is_there])


def test_logs_begin_in_their_month_and_bad_ones_are_known(fleet: SimulatedFleet) -> None:
    assert len(fleet.logs) == PLAN.drives
    assert 0 < sum(drive.city < 0 for drive in fleet.drives.values()) < PLAN.drives
    first, last = (log for log in (fleet.logs[0], fleet.logs[-1]))
    days = []
    for log in (first, last):
        with LogReader(log.path) as reader:
            stamps = [info.first_log_time_ns for info in reader.topics() if info.first_log_time_ns is not None]
        if stamps:
            days.append(min(stamps) // (86_400 * 10**9))
    assert days == sorted(days)
    assert len(days) < 2 or days[1] - days[0] >= 90
