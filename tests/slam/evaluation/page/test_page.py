"""The page: whole, escaped, offline."""

from __future__ import annotations

import re
from html import unescape

import numpy as np
import pytest

from logs.messages import GroundTruthPose, LoopClosureRecord, ObjectMapRecord, StatusRecord, TrajectoryRecord
from slam.evaluation.evaluate import evaluate
from slam.evaluation.inputs.records import EvaluationRecords, collect_records
from slam.evaluation.page.page import compose_page
from tests.slam.evaluation.maps import object_map
from tests.slam.evaluation.report.test_closure_reports import there_and_back_log

HOSTILE = '</script><b>O\'Brien & "sons"\n%{x}'
PICTURES = ("Map", "Error along the path", "Precision and recall")


def without(*kinds: type) -> EvaluationRecords:
    """120 m and back, with a landmark at no place, and classes and a status with names made to harm."""
    positions = np.array([[10.0, 4.0, 1.0], [60.0, -4.0, np.nan]])
    log = [
        *there_and_back_log(),
        ("/slam/map", object_map(("a", HOSTILE), positions, (HOSTILE, "tree"))),
        ("/slam/status", StatusRecord(0, "MAPPING", "info", HOSTILE, {HOSTILE: 3, "keyframes": 121})),
    ]
    return collect_records((topic, record) for topic, record in log if not isinstance(record, kinds))


def page_of(records: EvaluationRecords, title: str = "a drive") -> str:
    return compose_page(records, evaluate(records), title=title)


def text_of(page: str) -> str:
    return unescape(re.sub(r"<[^>]*>", " ", page))


@pytest.fixture(scope="module")
def page() -> str:
    return page_of(without(), title=HOSTILE)


def test_page_holds_every_part(page: str) -> None:
    assert re.findall(r'<img alt="([^"]*)" src="data:image/png;base64,', page) == list(PICTURES)
    text = " ".join(text_of(page).split())
    for part in ("precision 50.00 % (1 true, 1 false)", "median_translation_error_m", "counters", "Not measured"):
        assert part in text
    for rule in evaluate(without()).protocol.describe().values():
        assert rule in text


def test_names_from_log_stay_text(page: str) -> None:
    assert "<b>O'" not in page
    assert 'O\'Brien & "sons"' in text_of(page)


def test_page_needs_no_network_and_no_script(page: str) -> None:
    assert not re.search(r'\b(src|href|srcset|action)="(?!data:)|url\(|@import|<script', page)
    assert "default-src 'none'" in page


def test_same_input_gives_same_text(page: str) -> None:
    records = without()
    assert compose_page(records, evaluate(records), title=HOSTILE) == page


@pytest.mark.parametrize(
    ("left_out", "missing", "reason"),
    [
        ((GroundTruthPose,), PICTURES[1:], "no ground truth"),
        ((LoopClosureRecord,), PICTURES[2:], "associations"),
        ((TrajectoryRecord,), PICTURES[1:2], "was not finished"),
        ((TrajectoryRecord, GroundTruthPose, ObjectMapRecord), PICTURES, "no ground truth"),
    ],
)
def test_page_leaves_out_pictures_of_what_is_missing(
    left_out: tuple[type, ...], missing: tuple[str, ...], reason: str
) -> None:
    page = page_of(without(*left_out))
    assert [name for name in PICTURES if f'<img alt="{name}"' not in page] == list(missing)
    assert reason in text_of(page)
