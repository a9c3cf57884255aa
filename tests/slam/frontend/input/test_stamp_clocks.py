"""Clocks of stamps that are set while the logger's clock goes on, and whose stamps are wrong."""

from array import array
from collections.abc import Callable

import numpy as np
import pytest

from logs.messages import ObjectDetections, Odometry, Record
from logs.reader import LogItem
from logs.topics import Channel, RawMessage
from slam.frontend.input.stamp_clocks import CONFIRMING, ClockDrift, LoggingDelays, StampClocks, _rate
from tests.helpers.landmarks import detections_of

TENTH_NS = 100_000_000
S_NS = 10**9
START_NS = 1000 * S_NS
MESSAGES, SET_AT = 60, 30


def item(record: Record, logged_ns: int, topic: str = "/detections") -> LogItem:
    return LogItem(RawMessage(Channel(topic, "protobuf", None), logged_ns, logged_ns, 0, b""), (record,))


def scan(stamp_ns: int) -> ObjectDetections:
    return detections_of([], stamp_ns=stamp_ns)


def followed(
    stamp_error_ns: Callable[[int], int], late_ns: Callable[[int], int] = lambda row: 0
) -> tuple[list[float], StampClocks]:
    """By how many seconds stamps that err, of scans that are logged late, are wrong once they are followed."""
    clocks, found = StampClocks(), []
    for row in range(MESSAGES):
        made_ns = START_NS + row * TENTH_NS
        found += clocks.follow(item(scan(made_ns + stamp_error_ns(row)), made_ns + late_ns(row)))
    found += clocks.finish()
    assert len(found) == MESSAGES
    return [(each.stamp_ns - START_NS - row * TENTH_NS) / S_NS for row, each in enumerate(found)], clocks


def jitter_ns(row: int) -> int:
    return 30_000_000 + 2_000_000 * (row * 7 % 5)


@pytest.mark.parametrize("step_s", [-30, -3, 30, 1_000_000])
def test_a_clock_that_is_set_is_put_right_from_the_first_message_on(step_s: int) -> None:
    errors, clocks = followed(lambda row: step_s * S_NS * (row >= SET_AT), jitter_ns)
    assert max(np.abs(errors)) < 0.01
    (step,) = clocks.steps
    assert step.step_ns == pytest.approx(step_s * S_NS, abs=10_000_000)
    assert f"/detections was set {'forward' if step_s > 0 else 'back'} by {abs(step_s)}." in str(step)


@pytest.mark.parametrize(("then_s", "late_s"), [(20, 0), (0, 5)])
def test_a_clock_that_is_set_twice_or_once_before_messages_take_longer(then_s: int, late_s: int) -> None:
    errors, clocks = followed(
        lambda row: S_NS * (-20 * (row >= 20) + then_s * (row >= 40)), lambda row: late_s * S_NS * (row >= 40)
    )
    assert max(np.abs(errors)) < 0.01
    assert sum(step.step_ns for step in clocks.steps) == (then_s - 20) * S_NS


@pytest.mark.parametrize("length", [1, CONFIRMING - 1])
def test_single_wrong_stamps_are_left_as_they_are(length: int) -> None:
    errors, clocks = followed(lambda row: -30 * S_NS * (SET_AT <= row < SET_AT + length))
    assert errors == [-30.0 * (SET_AT <= row < SET_AT + length) for row in range(MESSAGES)]
    assert clocks.steps == []


def test_stamps_that_run_backwards_are_no_clock_that_was_set() -> None:
    errors, clocks = followed(lambda row: (20 - 2 * (row - SET_AT)) * TENTH_NS * (row >= SET_AT))
    assert clocks.steps == []
    assert errors[-1] == pytest.approx(2.0 - 0.2 * (MESSAGES - 1 - SET_AT))


def never(row: int) -> int:
    return 0


@pytest.mark.parametrize(
    ("stamp_error_ns", "late_ns"),
    [
        (never, lambda row: 5 * S_NS * (row >= SET_AT)),
        (never, lambda row: 5 * S_NS * (row < SET_AT)),
        (never, lambda row: (9 - row % 10) * TENTH_NS),
        (lambda row: -5 * TENTH_NS * (row // 6 % 2), never),
    ],
    ids=["logged later", "logged sooner", "written once a second", "stamps to and fro"],
)
def test_stamps_stay_as_they_are_where_no_clock_was_set(
    stamp_error_ns: Callable[[int], int], late_ns: Callable[[int], int]
) -> None:
    errors, clocks = followed(stamp_error_ns, late_ns)
    assert clocks.steps == []
    assert errors == [stamp_error_ns(row) / S_NS for row in range(MESSAGES)]


def test_messages_that_are_logged_in_batches_may_vary_as_much_again() -> None:
    clocks = StampClocks()
    for row in range(MESSAGES):
        made_ns = START_NS + row * TENTH_NS
        late_ns = (4 - row % 5) * TENTH_NS if row < SET_AT else 6 * TENTH_NS
        assert len(list(clocks.follow(item(scan(made_ns), made_ns + late_ns)))) == 1


def test_each_topic_has_a_clock_of_its_own() -> None:
    clocks = StampClocks()
    found = []
    for row in range(MESSAGES):
        made_ns = START_NS + row * TENTH_NS
        found += clocks.follow(item(scan(made_ns), made_ns, "/front"))
        found += clocks.follow(item(scan(made_ns - 30 * S_NS * (row >= SET_AT)), made_ns, "/rear"))
    assert [step.topic for step in clocks.steps] == ["/rear"]
    assert sorted(each.stamp_ns for each in found) == [START_NS + row // 2 * TENTH_NS for row in range(2 * MESSAGES)]


def test_median_delays_of_odometry_and_detections() -> None:
    clocks = StampClocks()
    assert clocks.delays() == LoggingDelays()
    for row in range(9):
        made_ns = START_NS + row * TENTH_NS
        list(clocks.follow(item(scan(made_ns), made_ns + 80_000_000 + row, "/detections")))
        list(clocks.follow(item(Odometry(made_ns, np.eye(4)), made_ns + 5_000_000, "/odom")))
    assert clocks.delays() == LoggingDelays(pytest.approx(0.005), pytest.approx(0.08))


@pytest.mark.parametrize("interval_ns", [0, TENTH_NS])
def test_log_times_that_count_from_elsewhere_tell_nothing(interval_ns: int) -> None:
    clocks = StampClocks()
    for row in range(9):
        list(clocks.follow(item(scan(START_NS + row * TENTH_NS), row * interval_ns, "/detections")))
        list(clocks.follow(item(Odometry(START_NS + row * TENTH_NS, np.eye(4)), row * interval_ns, "/odom")))
    assert clocks.delays() == LoggingDelays()


@pytest.mark.parametrize(
    ("odometry_s", "detections_s", "delay_s", "blamed"),
    [
        (0.0, 0.0, -0.1, None),  # log times are copies of the stamps
        (0.0, -0.1, -0.1, True),  # stamped 0.1 s later than they were logged
        (0.0, 0.1, 0.1, True),  # log times differ by as much as the stamps are wrong
        (0.002, 0.001, -0.1, True),  # stamped when they were sent: the odometry cannot have been logged before
        (0.001, 0.06, 0.1, False),  # the detections cannot be of after they were logged
        (-0.1, 0.0, 0.1, False),  # odometry stamped later than it was logged
    ],
)
def test_whose_stamps_are_wrong(odometry_s: float, detections_s: float, delay_s: float, blamed: bool | None) -> None:
    assert LoggingDelays(odometry_s, detections_s).blame_detections(delay_s) is blamed


def drifting(
    rate: float, *, late_ns: Callable[[int], int] = jitter_ns, clocks: StampClocks | None = None
) -> StampClocks:
    """Scans of a clock that loses ``rate``, and odometry of one that does not, for 100 s."""
    clocks = clocks or StampClocks()
    for row in range(1000):
        made_ns = row * TENTH_NS
        list(clocks.follow(item(scan(START_NS + made_ns - round(rate * made_ns)), START_NS + made_ns + late_ns(row))))
        list(clocks.follow(item(Odometry(START_NS + made_ns, np.eye(4)), START_NS + made_ns, "/odom")))
    return clocks


@pytest.mark.parametrize("rate", [2e-4, -2e-4, 9e-4])
def test_a_clock_that_drifts_is_found_and_put_right(rate: float) -> None:
    drift = drifting(rate).drift()
    assert drift.rate == pytest.approx(rate, rel=0.01)
    assert f"is {'slow' if rate > 0 else 'fast'} by {1e6 * abs(rate):.0f} parts" in str(drift)
    last_ns = START_NS + 999 * TENTH_NS
    corrected = drift.correct(scan(last_ns - round(rate * 999 * TENTH_NS)))
    assert corrected.stamp_ns == pytest.approx(last_ns, abs=2_000_000)
    assert drifting(rate, clocks=StampClocks(drift)).drift().rate == 0.0


@pytest.mark.parametrize(("scatters", "is_significant"), [(5.9, False), (6.1, True)])
def test_rate_is_that_of_the_least_delays_beyond_six_times_their_scatter(scatters: float, is_significant: bool) -> None:
    seconds = np.arange(16.0)
    rate = scatters * 1e-3 * np.sqrt(16.0 / 14.0) / 15.0
    delays_ns = 1e9 * (0.1 + rate * seconds + np.tile([1e-3, -1e-3, -1e-3, 1e-3], 4))
    found = _rate(array("q", (seconds * S_NS).astype(int)), array("q", delays_ns.astype(int)))
    assert found == pytest.approx(rate * is_significant, rel=1e-4)


def test_the_stamps_of_the_odometry_are_the_measure() -> None:
    message = Odometry(START_NS, np.eye(4))
    assert ClockDrift(1e-4, 0).correct(message) is message


@pytest.mark.parametrize("rate", [0.0, 5e-5, 2e-3])
def test_drifts_that_do_no_harm_and_queues_are_left(rate: float) -> None:
    assert drifting(rate).drift().rate == 0.0


def test_delays_that_vary_show_no_drift() -> None:
    rng = np.random.default_rng(0)
    late_ns = (1e8 * rng.random(1000) + 5e7 * np.sin(np.arange(1000) / 200.0)).astype(int).tolist()
    assert drifting(2e-4, late_ns=late_ns.__getitem__).drift().rate == 0.0


def test_a_clock_that_was_set_again_and_again_tells_of_no_drift() -> None:
    clocks = StampClocks()
    for row in range(10000):
        made_ns = START_NS + row * TENTH_NS
        list(clocks.follow(item(scan(made_ns - 3 * TENTH_NS * (row // 3334)), made_ns)))
    assert len(clocks.steps) == 2
    assert clocks.drift().rate == 0.0
