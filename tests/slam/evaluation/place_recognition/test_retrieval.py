"""The retrieval stage alone: ranks of what descriptors propose, from the estimator to the recall."""

from __future__ import annotations

from collections import defaultdict
from dataclasses import replace

import pytest

from logs.messages import LoopClosureRecord
from slam.common.errors import EvaluationError
from slam.evaluation.inputs.protocol import Protocol
from slam.evaluation.inputs.records import EvaluationRecords
from slam.evaluation.place_recognition.retrieval import RetrievalQuality, evaluate_retrieval
from slam.evaluation.place_recognition.revisits import find_revisits
from slam.loop_closure.consistency import suppress_non_maxima
from tests.helpers.candidates import make_candidate
from tests.slam.evaluation.loops import closure, keyframes, there_and_back

TRUTH = there_and_back()


def measure(records: list[LoopClosureRecord], *, place_count: int | None = 25) -> RetrievalQuality:
    ids, stamps_ns = keyframes(range(0, 241, 2))
    revisits = find_revisits(ids, stamps_ns, TRUTH, Protocol())
    stamp_of_keyframe = dict(zip(ids.tolist(), stamps_ns.tolist(), strict=True))
    return evaluate_retrieval(records, revisits, stamp_of_keyframe, TRUTH, Protocol(), place_count=place_count)


def test_recall_counts_the_best_rank_of_a_right_proposal() -> None:
    found = measure(
        [
            closure(200, 40, truth=TRUTH, rank=1),
            closure(210, 100, truth=TRUTH, shift_m=50.0, rank=1),
            closure(210, 30, truth=TRUTH, stage="acceptance", rank=4),
            closure(220, 100, truth=TRUTH, shift_m=50.0, rank=1),
            closure(220, 20, truth=TRUTH, stage="acceptance", rank=25),
            closure(230, 100, truth=TRUTH, shift_m=50.0, rank=1),
        ]
    )
    assert found.query_count == 4
    assert [found.recall_at(k) for k in (1, 5, 25)] == [0.25, 0.5, 0.75]
    assert found.note == ""


def test_right_place_counts_without_transform() -> None:
    at_place = closure(200, 44, stage="registration", rank=1)  # 4 m from the query
    beside = closure(210, 36, stage="registration", rank=1)  # 6 m from the query
    from_afar = closure(220, 28, truth=TRUTH, shift_m=3.9, rank=1)  # the reference is 8 m off, the transform true
    wrong = closure(230, 18, truth=TRUTH, shift_m=4.1, rank=1)
    assert measure([at_place, beside, from_afar, wrong]).hit_counts[1] == 2


def test_retrieval_counts_only_queried_revisits() -> None:
    followed = closure(200, 40, truth=TRUTH)
    nothing_found = replace(closure(210, -1, stage="retrieval"), reference_stamp_ns=0)
    no_revisit = closure(100, 20, truth=TRUTH, shift_m=30.0, rank=1)
    thinned_out = closure(211, 29, truth=TRUTH, rank=1)
    found = measure([followed, nothing_found, no_revisit, thinned_out, closure(220, 20, truth=TRUTH, rank=1)])
    assert (found.query_count, found.hit_counts[1]) == (2, 1)


def test_proposal_counts_despite_later_propagated_closure() -> None:
    proposed = closure(200, 40, truth=TRUTH, stage="acceptance", rank=2)
    assert measure([proposed, closure(200, 40, truth=TRUTH)]).hit_counts == {1: 0, 5: 1, 25: 1}


def test_recall_beyond_verified_places_is_undefined() -> None:
    records = [closure(200, 40, truth=TRUTH, rank=3)]
    found = measure(records, place_count=3)
    assert [found.recall_at(k) for k in (1, 5, 25)] == [0.0, None, None]
    assert "recall at 5 and 25 is undefined: 3 places" in found.note
    assert "--set loop_closure.max_candidates=25 --set loop_closure.propagation_distance_m=0" in found.note
    # A log that does not tell its configuration tells the largest rank.
    assert measure(records, place_count=None).place_count == 3
    assert measure([*records, closure(100, 20, truth=TRUTH, rank=25)], place_count=None).recall_at(25) == 1.0


def test_queries_that_were_not_looked_up_were_not_asked() -> None:
    found = measure([closure(200, -1, stage="retrieval"), closure(210, -1, stage="repeated")])
    assert found.query_count == 1


def test_logs_without_ranks_are_refused() -> None:
    with pytest.raises(EvaluationError, match=r"none of 2 records.*replay the log again"):
        measure([closure(200, -1, stage="retrieval"), closure(210, 30, truth=TRUTH)])


@pytest.mark.slow
def test_only_descriptor_proposals_have_ranks(looked_up: EvaluationRecords) -> None:
    ranks_of_query = defaultdict[int, set[int]](set)
    predicted = set[int]()
    for record in looked_up.closures:
        if record.reason.startswith("propagated") or record.stage == "retrieval":
            assert record.rank == 0
        elif record.rank:
            ranks_of_query[record.query_keyframe_id].add(record.rank)
        else:
            predicted.add(record.query_keyframe_id)
    assert len(ranks_of_query) > 10
    assert all(ranks <= {1, 2, 3, 4, 5} for ranks in ranks_of_query.values())
    # The first may be where a hypothesis is already.
    assert all(1 in ranks or query in predicted for query, ranks in ranks_of_query.items())
    founders = [r for r in looked_up.closures if r.accepted and not r.reason.startswith("propagated")]
    assert founders
    assert all(record.rank > 0 or record.query_keyframe_id in predicted for record in founders)


def test_places_that_become_one_keep_the_best_rank() -> None:
    second, first = (replace(make_candidate(llrs={0: llr}), rank=rank) for llr, rank in ((30.0, 2), (20.0, 1)))
    kept = suppress_non_maxima([first, second], sensor_range_m=30.0)
    assert [(candidate.rank, candidate.score) for candidate in kept] == [(1, 30.0)]


def test_status_counts_retrieved_closures(kidnapped: EvaluationRecords) -> None:
    seeds = [each.seed_query_keyframe_id for each in kidnapped.closures if each.accepted]
    assert kidnapped.status.counters["closures_retrieved"] == seeds.count(None)
    assert 0 < seeds.count(None) < len(seeds)
