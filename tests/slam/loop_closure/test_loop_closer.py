"""Loop closing from log to log: what it finds, what it makes better, and what it says of every candidate.

Each expectation has a twin in which one part is made useless, and in which it must fail.
"""

from unittest.mock import patch

import numpy as np
import pytest
from scipy.special import logit

from slam.common.config import LocalizationConfig
from slam.simulation.config import KidnapConfig
from tests.helpers.loop_drives import (
    TWO_BLOCKS_ROUND_M,
    Outcome,
    replay_drive,
    rows_of_lamps,
    two_blocks,
    winding_street,
)
from tests.helpers.short_drives import final_status

pytestmark = pytest.mark.slow

LEAST_LOG_ODDS = -logit(LocalizationConfig().error_probability)


@pytest.fixture(scope="module")
def looped(tmp_path_factory) -> Outcome:
    """Two blocks, of which much is driven again, with the default configuration."""
    return replay_drive(tmp_path_factory.mktemp("looped"), two_blocks())


@pytest.fixture(scope="module")
def open_ended(tmp_path_factory) -> Outcome:
    """The same without closing loops, by closures or by landmarks that are merged at the end."""
    with patch("slam.graph_condenser.fuse_landmarks", lambda *_: 0):
        return replay_drive(tmp_path_factory.mktemp("open"), two_blocks(), enabled=False)


@pytest.fixture(scope="module")
def straying(tmp_path_factory) -> Outcome:
    """A drive that never comes back."""
    return replay_drive(tmp_path_factory.mktemp("straying"), winding_street())


# What it finds


def test_loops_are_closed_in_both_directions_and_all_of_them_are_right(looped):
    assert looped.closures["precision"] == 1.0
    assert looped.closures["true_count"] > 50
    for direction, least in (("same", 20), ("opposite", 40)):
        assert looped.closures[f"revisit_count_{direction}"] >= least
        recall = looped.closures[f"recall_{direction}"]
        assert recall >= 0.9
    assert looped.closures["median_translation_error_m"] < 0.5
    assert looped.closures["median_rotation_error_deg"] < 1.0


def test_the_log_says_what_each_candidate_was_decided_from(looped):
    candidates = [each for each in looped.evaluation.closures["record"] if each.log_likelihood_ratio is not None]
    accepted = [each for each in candidates if each.accepted]
    assert all(each.score == pytest.approx(each.log_likelihood_ratio - each.odometry_penalty) for each in candidates)
    assert 0 < sum(each.inserted for each in accepted) < len(accepted)
    for each in candidates:
        told = "" if each.seed_query_keyframe_id is None else f"of keyframe {each.seed_query_keyframe_id}"
        assert told in each.reason
        assert ("propagated" in each.reason) == (told != "")
        assert each.seed_query_keyframe_id is None or each.posterior_log_odds is None
    alone = [each for each in accepted if not each.reason]
    assert alone
    for each in alone:
        assert each.posterior_log_odds >= LEAST_LOG_ODDS
        assert each.score >= LEAST_LOG_ODDS


# What it makes better


def test_closures_make_the_trajectory_better(looped, open_ended, tmp_path):
    """Mean of two drives, because the odometry of one drifts little by chance."""
    again = replay_drive(tmp_path, two_blocks(), seed=2).ate_m
    with patch("slam.graph_condenser.fuse_landmarks", lambda *_: 0):
        apart = replay_drive(tmp_path, two_blocks(), seed=2, enabled=False).ate_m
    assert looped.ate_m + again < 0.4 * (open_ended.ate_m + apart)


# What it leaves alone


def test_a_drive_without_revisits_accepts_nothing(straying):
    assert straying.closures["revisit_count"] == 0
    assert straying.closures["candidate_count"] > 100
    assert straying.closures["accepted_count"] == 0


@pytest.mark.parametrize("spacing_m", [8.0, 20.0], ids=["dense", "sparse"])
def test_two_streets_of_lamps_in_rows_are_not_taken_for_one(tmp_path, spacing_m):
    """Where they are sparse, only the odometry can tell them apart."""
    outcome = replay_drive(tmp_path, rows_of_lamps(spacing_m))
    assert outcome.closures["revisit_count"] == outcome.accepted_count == 0
    assert "closure" not in outcome.graph.edge_kinds


# What it says


def test_every_keyframe_that_could_close_a_loop_has_a_verdict(looped):
    graph = looped.graph
    stamp_of = dict(zip(graph.keyframe_ids.tolist(), graph.keyframe_stamps_ns.tolist(), strict=True))
    judged = {record.query_keyframe_id for record in looped.records}
    late = [keyframe for keyframe in stamp_of if keyframe > min(judged)]
    assert len(late) > 100
    assert judged.issuperset(late)
    for record in looped.records:
        assert record.stamp_ns == stamp_of[record.query_keyframe_id]
        if record.reference_keyframe_id >= 0:
            assert record.reference_stamp_ns == stamp_of[record.reference_keyframe_id]


def test_the_closures_in_the_graph_are_those_that_are_said_to_be_inserted(looped):
    graph = looped.graph
    is_closure = np.array(graph.edge_kinds) == "closure"
    edges = {(int(reference), int(query)) for reference, query in graph.edge_keyframe_ids[is_closure]}
    last = {(record.reference_keyframe_id, record.query_keyframe_id): record for record in looped.records}
    assert edges == {pair for pair, record in last.items() if record.inserted}
    assert 5 <= len(edges) < looped.closures["accepted_count"]


def test_closing_no_loops_writes_no_candidates(open_ended):
    assert open_ended.records == []
    assert "closure" not in open_ended.graph.edge_kinds
    assert open_ended.closures["recall"] == 0.0


# Breaks of the odometry


@pytest.mark.parametrize(
    ("kidnap", "counter", "recall"),
    [({"gap_s": 30.0}, "odometry_breaks", 0.9), ({"silent": True}, "kidnappings_detected", 0.0)],
    ids=["break", "silent"],
)
def test_loops_are_closed_after_a_kidnapping_and_keyframes_before_are_where_the_robot_was(
    tmp_path, kidnap, counter, recall
):
    """From the far corner to the beginning, with the last street of the round never seen. Where the odometry does not
    show it, some keyframes later the landmarks do.
    """
    moved = KidnapConfig(from_m=300.0, to_m=TWO_BLOCKS_ROUND_M, **kidnap)
    outcome = replay_drive(tmp_path, two_blocks(), kidnap=moved)
    assert final_status(outcome.path).counters[counter] == 1
    assert outcome.closures["recall"] >= recall
    assert outcome.graph.edge_kinds.count("discontinuity") == 1
    assert outcome.closures["precision"] == 1.0
    assert outcome.ate_m < 0.5
