"""The final decision about each loop-closure candidate of a log."""

from collections.abc import Iterable
from enum import StrEnum

from logs.messages import LoopClosureRecord


class Stage(StrEnum):
    """Where a candidate is decided, in the order in which it comes there; what is repeated was not looked up."""

    REPEATED = "repeated"
    RETRIEVAL = "retrieval"
    REGISTRATION = "registration"
    ACCEPTANCE = "acceptance"
    CONSISTENCY = "consistency"
    ACCEPTED = "accepted"


def find_final_decisions(records: Iterable[LoopClosureRecord]) -> tuple[LoopClosureRecord, ...]:
    """The last record about each two keyframes, by query stamp, then query and reference id.

    Args:
        records: in the order of the log.
    """
    last = {(record.query_keyframe_id, record.reference_keyframe_id): record for record in records}
    return tuple(sorted(last.values(), key=lambda r: (r.stamp_ns, r.query_keyframe_id, r.reference_keyframe_id)))
