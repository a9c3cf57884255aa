"""What a robot passed while it is looked for in an imported map."""

from __future__ import annotations

from dataclasses import replace

from slam.loop_closure.stretches import STRETCHES, Stretches
from tests.slam.loop_closure.doubles import make_keyframe, make_query

STEP_M = 10.0


def remembered(*travels_m: float) -> Stretches:
    stretches = Stretches(STEP_M)
    for number, travel_m in enumerate(travels_m):
        stretches.remember(make_query(make_keyframe(number, travel_m)))
    return stretches


def test_a_query_is_kept_where_a_stretch_ends() -> None:
    kept = remembered(0.0, 6.0, 10.0, 19.0, 21.0).before(make_keyframe(9, 30.0))
    assert [each.travel_m for each in kept] == [21.0, 10.0, 0.0]


def test_the_oldest_are_forgotten() -> None:
    kept = remembered(*(STEP_M * number for number in range(STRETCHES + 2))).before(make_keyframe(99, 999.0))
    assert [each.keyframe.id for each in kept] == list(range(STRETCHES + 1, 1, -1))


def test_those_of_another_segment_do_not_count() -> None:
    here = make_keyframe(9, 30.0)
    elsewhere = replace(here, odometry=replace(here.odometry, segment=here.odometry.segment + 1))
    assert remembered(0.0, 10.0).before(elsewhere) == ()


def test_what_is_remembered_holds_nothing_that_was_before() -> None:
    stretches = Stretches(STEP_M)
    first = make_query(make_keyframe(0, 0.0))
    stretches.remember(replace(first, before=(first,)))
    assert stretches.before(make_keyframe(1, 5.0))[0].before == ()
