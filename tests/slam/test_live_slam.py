"""A map of a robot that is calibrated during its drive."""

from functools import cache
from itertools import pairwise
from pathlib import Path
from threading import Event

import numpy as np
import pytest

from logs.messages import ObjectDetections, Record, SlamPose, StatusRecord
from slam import live_slam
from slam.common.calibration import Calibration
from slam.common.config import Config
from slam.common.errors import SavedMapError
from slam.evaluation.inputs.records import collect_records
from slam.final_map import FinalMap
from slam.live_slam import LiveSlam
from slam.localization.state import CALIBRATIONS
from slam.object_map.map_io import confirmed, load_map
from slam.provenance import recorded_config
from slam.self_calibration.survey import survey
from slam.simulation.config import SimulationConfig
from slam.system import Slam
from tests.helpers.short_drives import drive, keep_until

SECONDS = 6.0


@cache
def records() -> tuple[Record, ...]:
    """The input of a short drive with noise."""
    entries = keep_until(drive(SimulationConfig()), SECONDS)
    return tuple(record for topic, _, record in entries if not topic.startswith("/ground_truth"))


@cache
def driven() -> tuple[LiveSlam, tuple[tuple[Record, ...], ...], FinalMap]:
    """A system after the drive, what each of the records made known, and the final map."""
    slam = LiveSlam(Config())
    updates = tuple(tuple(slam.process(record)) for record in records())
    return slam, updates, slam.finish()


def live_updates() -> tuple[tuple[Record, ...], ...]:
    return driven()[1]


def poses(updates: tuple[tuple[Record, ...], ...]) -> list[tuple[int, bytes]]:
    return [
        (each.stamp_ns, each.T_map_body.tobytes()) for step in updates for each in step if isinstance(each, SlamPose)
    ]


def test_live_estimates_do_not_depend_on_what_comes_later():
    slam, half = LiveSlam(Config()), len(records()) // 2
    first = tuple(tuple(slam.process(record)) for record in records()[:half])
    assert poses(first) == poses(live_updates()[:half])


def test_calibration_is_estimated_each_time_that_scans_have_doubled():
    statuses = [each for step in live_updates() for each in step if isinstance(each, StatusRecord)]
    messages = {each.counters[CALIBRATIONS]: each.message for each in statuses if each.counters.get(CALIBRATIONS)}
    surveyed = [int(message.split()[2]) for message in messages.values()]
    scans = sum(isinstance(record, ObjectDetections) for record in records())
    assert list(messages) == list(range(1, len(messages) + 1))
    assert all(later in (2 * count, 2 * count + 1) for count, later in pairwise(surveyed))
    assert 2 * surveyed[-1] * 5 / 3 > scans


def test_messages_do_not_wait_while_the_calibration_is_estimated(monkeypatch: pytest.MonkeyPatch):
    begun, mapped, done = Event(), Event(), Event()

    def slow(*inputs):
        begun.set()
        mapped.wait(2.0)
        done.set()
        return survey(*inputs)

    monkeypatch.setattr(live_slam, "survey", slow)
    slam = LiveSlam(Config())
    for record in records():
        slam.process(record)
        if begun.is_set():
            break
    assert begun.is_set()
    assert not done.is_set()
    mapped.set()


def test_one_pose_is_published_for_each_odometry_message():
    stamps = [stamp_ns for stamp_ns, _ in poses(live_updates())]
    assert len(stamps) == len(set(stamps))


def test_map_is_the_one_that_the_last_calibration_makes_of_all_records():
    slam, _, final = driven()
    again = Slam(slam.calibration.config)
    for record in records():
        again.process(record)
    assert slam.calibration.estimated
    np.testing.assert_array_equal(final.object_map.positions, again.finish().object_map.positions)


def test_saved_map_holds_the_landmarks_and_the_calibration(tmp_path: Path):
    slam, _, final = driven()
    slam.save(tmp_path / "map.mcap", final)
    saved = load_map(tmp_path / "map.mcap")
    assert set(saved.objects.ids) == set(confirmed(final.object_map).ids)
    assert recorded_config(saved.metadata).calibration == slam.calibration.config.calibration
    lost = LiveSlam(Config(), saved)
    with pytest.raises(SavedMapError, match="never relocalized"):
        lost.save(tmp_path / "extended.mcap", final)


def test_calibration_that_is_complete_is_kept():
    calibration = Calibration.model_validate(Calibration().model_dump(exclude_none=True))
    live, known = LiveSlam(Config(), calibration=calibration), Slam(Config(calibration=calibration))
    updates = tuple(tuple(live.process(record)) for record in records())
    assert poses(updates) == poses(tuple(tuple(known.process(record)) for record in records()))
    assert live.calibration.config.calibration == calibration


def test_evaluation_takes_associations_and_closures_of_the_last_map_only():
    found = collect_records(("/slam", each) for step in live_updates() for each in step)
    stamps = [each.stamp_ns for each in found.associations]
    assert len(stamps) == len(set(stamps))
    assert len(stamps) == sum(isinstance(record, ObjectDetections) for record in records())
