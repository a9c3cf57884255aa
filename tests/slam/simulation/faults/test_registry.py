from __future__ import annotations

import numpy as np
import pytest

from logs.topics import RecordKind
from slam.common.errors import ConfigurationError, SimulationError
from slam.simulation.faults.faulty_log import apply_faults
from slam.simulation.faults.registry import DEGRADATIONS, FAULTS, all_cases, parse_fault, parse_faults
from slam.simulation.faults.stream import Entry
from tests.slam.simulation.faults.streams import changed_topics, drive, faulty, positions

pytestmark = pytest.mark.slow

TOPICS = {
    RecordKind.ODOMETRY: "/odom",
    RecordKind.DETECTIONS: "/detections",
    RecordKind.DETECTION_TRUTH: "/ground_truth/detections",
    RecordKind.OBJECT_TRUTH: "/ground_truth/objects",
    RecordKind.GROUND_TRUTH: "/ground_truth",
    RecordKind.TRANSFORMS: "/tf_static",
}


QUICK = {"objects_burst": "objects_burst=20:3", "keep_label": "keep_label=tree", "drop_label": "drop_label=tree"}


def contents(stream: list[Entry]) -> list[str]:
    with np.printoptions(threshold=10**6, precision=17):
        return [repr(entry) for entry in stream]


@pytest.mark.parametrize("name", FAULTS)
class TestEach:
    def test_it_changes_the_topics_that_it_says(self, name: str) -> None:
        before = drive()
        changed = changed_topics(before, apply_faults(before, [parse_fault(QUICK.get(name, name))], seed=0))
        said = {TOPICS[kind] for kind in FAULTS[name].changes}
        assert changed
        assert changed <= said
        assert {"/ground_truth", "/ground_truth/objects"}.isdisjoint(changed) or name in ("lengths_scaled", "reversed")

    def test_the_input_stays_as_it_is(self, name: str) -> None:
        before = drive()
        told = contents(before)
        apply_faults(before, [parse_fault(QUICK.get(name, name))], seed=0)
        assert contents(before) == told

    def test_the_same_seed_gives_the_same(self, name: str) -> None:
        typed = QUICK.get(name, name)
        assert contents(faulty(typed, seed=3)) == contents(faulty(typed, seed=3))

    def test_its_cases_are_allowed_and_its_name_is_read_again(self, name: str) -> None:
        fault = FAULTS[name]
        assert fault.name == name
        assert fault.meaning
        assert fault.takes_labels or parse_fault(fault.usage) == parse_fault(name)
        assert all(
            case.fault is fault and parse_fault(case.name) == case for case in all_cases([QUICK.get(name, name)])
        )


@pytest.mark.parametrize("name", ["odometry_jumps", "odometry_yaw_noise", "unreported_noise", "labels_random"])
def test_another_seed_gives_others(name: str) -> None:
    assert contents(faulty(name, seed=0)) != contents(faulty(name, seed=1))


def test_random_numbers_do_not_depend_on_the_faults_before() -> None:
    both, alone = faulty("odometry_jumps", "unreported_noise"), faulty("unreported_noise")
    told = [[repr(e) for e in stream if e.topic == "/detections"] for stream in (both, alone)]
    assert told[0] == told[1]


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
        ("heading_jump=30:2", ">= 0 and <= 1"),
        ("gyro_bias=3:10:5", "write gyro_bias=3:10"),
        ("labels_unique=1", "takes no value"),
        ("keep_label", "needs a label"),
        ("dropout=1.1", ">= 0 and <= 1"),
        ("field_of_view=0", "not allowed as deg"),
        ("odometry_jumps=2.5", "a whole number"),
        ("odometry_pause=-1", ">= 0"),
        ("odometry_pause=inf", "not allowed"),
    ],
)
def test_refusals(text: str, told: str) -> None:
    with pytest.raises(ConfigurationError) as refusal:
        parse_fault(text)
    assert told in str(refusal.value)
    assert "\n" not in str(refusal.value)


def test_what_is_measured() -> None:
    names = [case.name for case in all_cases()]
    assert len(set(names)) == len(names)
    assert set(FAULTS) - {parse_fault(name).fault.name for name in names} < set(DEGRADATIONS)
    assert [case.name for case in all_cases(["heading_jump=7", "scan_rate"])] == [
        "heading_jump=7:0.5",
        "scan_rate=1",
        "scan_rate=0.5",
    ]


def test_a_negative_seed_is_refused() -> None:
    with pytest.raises(SimulationError, match="negative"):
        apply_faults(drive(), parse_faults(["labels_random"]), seed=-1)
