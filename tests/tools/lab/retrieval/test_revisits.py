"""Descriptors asked at the revisits of a drive: only what they propose counts."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from slam.common.config import Config
from tests.helpers.loop_drives import SLOW, furnished
from tests.helpers.poses import pose_at
from tests.helpers.short_drives import drive, write_log
from tools.lab.retrieval.labelled_map import is_right
from tools.lab.retrieval.revisits import measure_revisits


@pytest.mark.slow
def test_descriptor_finds_places_that_random_vectors_do_not(tmp_path: Path) -> None:
    """Of one class: with several, random vectors find places in so small a map, too."""
    block = furnished([(0, 0), (60, 0), (60, 60), (0, 60)] * 3, seed=11)
    world = replace(block, labels=("tree",) * len(block.labels))
    log = write_log(tmp_path / "town.mcap", drive(SLOW, seed=4, world=world))
    good, random = measure_revisits(log, ["descriptellation_lr", "random"], Config())
    assert (good["drive"], good["descriptor"], random["descriptor"]) == ("town", "descriptellation_lr", "random")
    assert good["queries"] == random["queries"] >= 3
    assert good["places_at_1"] > random["places_at_1"] + 0.2
    for figures in (good, random):
        assert figures["places_at_1"] <= figures["places_at_5"] <= figures["places_at_25"]


def test_a_pose_is_right_within_4_m_and_10_deg_of_any_true_one() -> None:
    truth = np.array([np.eye(4), pose_at(50.0, yaw=3.0)])
    poses = np.array([pose_at(3.9, yaw=0.1), pose_at(4.1), pose_at(yaw=0.2), pose_at(50.0, 2.0, yaw=3.1)])
    assert is_right(poses, truth).tolist() == [True, False, False, True]
    assert is_right(poses[:0], truth).tolist() == []
