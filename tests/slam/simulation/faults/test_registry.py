import pickle

import numpy as np
import pytest

from logs.messages import GroundTruthPose
from slam.common.errors import ConfigurationError
from slam.simulation.faults import detections, odometry
from slam.simulation.faults.faulty_log import apply_faults
from slam.simulation.faults.recording import Recording
from slam.simulation.faults.registry import FAULTS, parse_faults
from tests.slam.simulation.faults.streams import drive, faulty, positions, stamps

QUICK = {"keep_label": "keep_label=tree"}


def contents(log: Recording, topic: str = "") -> list[bytes]:
    return [pickle.dumps(message) for message in log.messages if message.topic.startswith(topic)]


@pytest.mark.parametrize("name", FAULTS)
def test_fault_changes_only_what_it_is_about_and_repeats(name: str) -> None:
    typed, log = QUICK.get(name, name), drive()
    before, told = log.messages, contents(log)
    apply_faults(log, parse_faults([typed]), seed=3)
    assert contents(log) != told
    assert contents(log) == contents(faulty(typed, seed=3))
    assert [pickle.dumps(message) for message in before] == told
    for topic, module in {"/odom": detections, "/detections": odometry}.items():
        assert not hasattr(module, name) or contents(log, topic) == contents(drive(), topic)
    assert np.array_equal(stamps(log, GroundTruthPose), stamps(drive(), GroundTruthPose))
    assert FAULTS[name].meaning


def test_random_numbers_depend_on_seed_and_repetition_but_not_on_other_faults() -> None:
    both, alone = faulty("odometry_jumps,unreported_noise"), faulty("unreported_noise")
    assert contents(both, "/detections") == contents(alone, "/detections")
    assert contents(alone) != contents(faulty("unreported_noise", seed=1))
    once, twice = (positions(faulty(*["unreported_noise"] * times)) - positions(drive()) for times in (1, 2))
    assert twice.std() == pytest.approx(np.sqrt(2.0) * once.std(), rel=0.1)


def test_names_and_values_go_round() -> None:
    texts = ["gyro_bias", "gyro_bias=30, gyro-bias=30:1", "labels_unique", "keep_label=tree:lamp", "dropout=.30"]
    names = [fault.name for fault in parse_faults(texts)]
    assert names == [
        *("gyro_bias=3:10", "gyro_bias=30:10", "gyro_bias=30:1"),
        *("labels_unique", "keep_label=tree:lamp", "dropout=0.3"),
    ]
    assert [fault.name for fault in parse_faults(names)] == names
    is_random = [fault.is_random for fault in parse_faults(["dropout", "max_range", "keep_label=tree"])]
    assert is_random == [True, False, False]


@pytest.mark.parametrize(
    ("text", "told"),
    [
        ("heading_jmp=3", "did you mean heading_jump"),
        ("nothing", "--list-faults"),
        ("", "unknown fault"),
        ("heading_jump=much", "'much' is not allowed as deg"),
        ("heading_jump=", "'' is not allowed"),
        ("heading_jump=nan", "not allowed"),
        ("heading_jump=30:2", "part of the drive: Input should be less than or equal to 1"),
        ("gyro_bias=3:10:5", "write gyro_bias=3:10"),
        ("labels_unique=1", "takes no value"),
        ("keep_label", "needs a label"),
        ("odometry_jumps=2.5", "a valid integer"),
    ],
)
def test_refusals(text: str, told: str) -> None:
    with pytest.raises(ConfigurationError) as refusal:
        parse_faults([text])
    assert told in str(refusal.value)
    assert "\n" not in str(refusal.value)
