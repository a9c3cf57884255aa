from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from slam.common.errors import ConfigurationError, SimulationError
from slam.simulation.faults import detections, odometry
from slam.simulation.faults.faulty_log import apply_faults
from slam.simulation.faults.recording import Recording
from slam.simulation.faults.registry import FAULTS, all_cases, parse_fault, parse_faults
from tests.slam.simulation.faults.streams import drive, faulty, positions

pytestmark = pytest.mark.slow

QUICK = {"objects_burst": "objects_burst=20:3", "keep_label": "keep_label=tree", "drop_label": "drop_label=tree"}


def contents(log: Recording, topic: str = "") -> list[str]:
    with np.printoptions(threshold=10**6, precision=17):
        return [repr(message) for message in log.messages if message.topic.startswith(topic)]


@pytest.mark.parametrize("name", FAULTS)
class TestEach:
    def test_it_changes_odometry_or_detections(self, name: str) -> None:
        before, changed = drive(), faulty(QUICK.get(name, name))
        assert contents(changed) != contents(before)
        for topic, faults in {"/odom": vars(detections), "/detections": vars(odometry)}.items():
            assert name not in faults or contents(changed, topic) == contents(before, topic)
        if name not in ("lengths_scaled", "reversed"):
            others = [replace(log, odometry=(), scans=()) for log in (before, changed)]
            assert contents(others[0]) == contents(others[1])

    def test_the_input_stays_as_it_is(self, name: str) -> None:
        before = drive()
        told = contents(before)
        apply_faults(before, [parse_fault(QUICK.get(name, name))], seed=0)
        assert contents(before) == told

    def test_the_same_seed_gives_the_same(self, name: str) -> None:
        typed = QUICK.get(name, name)
        assert contents(faulty(typed, seed=3)) == contents(faulty(typed, seed=3))

    def test_its_name_is_read_again(self, name: str) -> None:
        fault = FAULTS[name]
        assert fault.name == name
        assert fault.meaning
        assert fault.takes_labels or parse_fault(fault.usage) == parse_fault(name)


@pytest.mark.parametrize("name", ["odometry_jumps", "odometry_yaw_noise", "unreported_noise", "labels_random"])
def test_another_seed_gives_others(name: str) -> None:
    assert contents(faulty(name, seed=0)) != contents(faulty(name, seed=1))


def test_random_numbers_do_not_depend_on_the_faults_before() -> None:
    both, alone = faulty("odometry_jumps", "unreported_noise"), faulty("unreported_noise")
    assert contents(both, "/detections") == contents(alone, "/detections")


def test_a_fault_that_comes_twice_draws_anew() -> None:
    once, twice = (positions(faulty(*["unreported_noise"] * times)) - positions(drive()) for times in (1, 2))
    assert twice.std() == pytest.approx(np.sqrt(2.0) * once.std(), rel=0.1)


def test_names_and_values() -> None:
    assert parse_fault("gyro_bias").values == (3.0, 10.0)
    assert parse_fault("gyro_bias=30").values == (30.0, 10.0)
    assert parse_fault("gyro-bias=30:1").name == "gyro_bias=30:1"
    assert parse_fault("labels_unique").name == "labels_unique"


@pytest.mark.parametrize(
    ("text", "told"),
    [
        ("heading_jmp=3", "did you mean heading_jump"),
        ("nothing", "--list-faults"),
        ("heading_jump=much", "'much' is not allowed as deg"),
        ("heading_jump=", "'' is not allowed"),
        ("heading_jump=nan", "not allowed"),
        ("heading_jump=30:2", "part of the drive: Input should be less than or equal to 1"),
        ("gyro_bias=3:10:5", "write gyro_bias=3:10"),
        ("labels_unique=1", "takes no value"),
        ("keep_label", "needs a label"),
        ("dropout=1.1", "less than or equal to 1"),
        ("field_of_view=0", "not allowed as deg"),
        ("odometry_jumps=2.5", "a valid integer"),
        ("odometry_pause=-1", "greater than or equal to 0"),
        ("odometry_pause=inf", "not allowed"),
    ],
)
def test_refusals(text: str, told: str) -> None:
    with pytest.raises(ConfigurationError) as refusal:
        parse_fault(text)
    assert told in str(refusal.value)
    assert "\n" not in str(refusal.value)


def test_every_case_is_measured_once_and_read_again() -> None:
    cases = all_cases()
    assert [parse_fault(case.name) for case in cases] == cases
    names = [case.name for case in cases]
    assert len(set(names)) == len(names)
    assert {"heading_jump=5:0.5", "heading_jump=180:0.5", "scan_rate=0.5", "dropout=0.3"} < set(names)
    assert {case.fault.name for case in cases} == set(FAULTS) - {"keep_label", "drop_label"}


def test_a_negative_seed_is_refused() -> None:
    with pytest.raises(SimulationError, match="negative"):
        apply_faults(drive(), parse_faults(["labels_random"]), seed=-1)
