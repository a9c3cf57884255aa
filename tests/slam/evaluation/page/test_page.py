"""The page: whole, escaped, offline."""

from __future__ import annotations

import re
from dataclasses import replace
from html import unescape
from pathlib import Path

import numpy as np
import pytest

from logs.errors import UnwritableLogError
from logs.messages import (
    GroundTruthPose,
    LoopClosureRecord,
    ObjectMapRecord,
    Odometry,
    Record,
    SlamPose,
    StatusRecord,
    TrajectoryRecord,
)
from slam.common.geometry import transform_from_xyz_yaw
from slam.evaluation.evaluate import evaluate
from slam.evaluation.inputs.records import EvaluationRecords, collect_records
from slam.evaluation.page.page import compose_page, write_page
from tests.slam.evaluation.loops import closure, there_and_back
from tests.slam.evaluation.maps import object_map
from tests.slam.evaluation.results import graph

HOSTILE = '</script><b>O\'Brien & "sons"\n%{x}'
PATHS = (TrajectoryRecord, SlamPose, Odometry, GroundTruthPose)
PICTURES = ("Map", "Error along the path", "Precision and recall")


def drive() -> list[tuple[str, Record]]:
    """120 m and back: closures of every label, odometry that veers off, and classes with names made to harm."""
    truth = there_and_back()
    index = np.arange(len(truth.stamps_ns))
    drifting = truth.T_world_body @ transform_from_xyz_yaw(np.zeros((len(index), 3)), 0.002 * index)
    drifting[:, 1, 3] += 0.02 * index
    closures = (
        closure(200, 40, truth=truth, shift_m=0.5, score=31.0),
        closure(202, 38, truth=truth, score=30.0),
        closure(210, 30, truth=truth, stage="consistency", score=12.0),
        closure(90, 0, truth=truth, shift_m=9.0, score=14.0),
        closure(230, 10, score=2.0),
        closure(180, 20, stage="a stage <i>of tomorrow</i>", reason=HOSTILE, score=float("nan")),
    )
    positions = np.array([[10.0, 4.0, 1.0], [60.0, -4.0, 0.0], [110.0, 5.0, np.nan], [np.nan, 0.0, 0.0], [5.0, 5.0, 0]])
    states = ("confirmed", "confirmed", "confirmed", "confirmed", "retired")
    labels = (HOSTILE, "tree", "tree", "pole", "tree")
    return [
        *(("/ground_truth", GroundTruthPose(t, T)) for t, T in zip(truth.stamps_ns, truth.T_world_body, strict=True)),
        *(("/odometry", Odometry(t, T)) for t, T in zip(truth.stamps_ns, drifting, strict=True)),
        *(("/slam/pose", SlamPose(t, T)) for t, T in zip(truth.stamps_ns, drifting, strict=True)),
        ("/slam/trajectory_stamped", TrajectoryRecord(0, "map", truth.stamps_ns, truth.T_world_body)),
        ("/slam/graph", graph(truth.stamps_ns[::2], truth.T_world_body[::2])),
        *(
            ("/slam/closures", replace(c, query_keyframe_id=c.query_keyframe_id // 2, reference_keyframe_id=k))
            for k, c in enumerate(closures)
        ),
        ("/slam/map", object_map(("a", "b", HOSTILE, "d", "e"), positions, labels, states=states)),
        ("/slam/status", StatusRecord(0, "MAPPING", "info", HOSTILE, {HOSTILE: 3, "keyframes": 121})),
    ]


def without(*kinds: type) -> EvaluationRecords:
    return collect_records((topic, record) for topic, record in drive() if not isinstance(record, kinds))


def page_of(records: EvaluationRecords, title: str = "a drive") -> str:
    return compose_page(records, evaluate(records), title=title)


def text_of(page: str) -> str:
    return unescape(re.sub(r"<[^>]*>", " ", page))


@pytest.fixture(scope="module")
def page() -> str:
    return page_of(collect_records(drive()), title=HOSTILE)


def test_page_holds_every_part(page: str) -> None:
    assert re.findall(r'<img alt="([^"]*)" src="data:image/png;base64,', page) == list(PICTURES)
    text = " ".join(text_of(page).split())
    for part in ("precision 66.67 % (2 true, 1 false)", "median_translation_error_m", "counters", "Not measured"):
        assert part in text
    for rule in evaluate(collect_records(drive())).protocol.describe().values():
        assert rule in text


def test_names_from_log_stay_text(page: str) -> None:
    assert "<b>O'" not in page
    assert 'O\'Brien & "sons"' in text_of(page)


def test_page_needs_no_network_and_no_script(page: str) -> None:
    assert not re.search(r'\b(src|href|srcset|action)="(?!data:)|url\(|@import|<script', page)
    assert "default-src 'none'" in page


def test_same_input_gives_same_bytes(page: str, tmp_path: Path) -> None:
    records = collect_records(drive())
    write_page(tmp_path / "report.html", records, evaluate(records), title=HOSTILE)
    assert (tmp_path / "report.html").read_bytes() == page.encode()
    assert [path.name for path in tmp_path.iterdir()] == ["report.html"]
    with pytest.raises(UnwritableLogError, match="nowhere"):
        write_page(tmp_path / "nowhere" / "report.html", records, evaluate(records), title="")


@pytest.mark.parametrize(
    ("left_out", "missing", "reason"),
    [
        ((GroundTruthPose,), PICTURES[1:], "no ground truth"),
        ((LoopClosureRecord,), PICTURES[2:], "associations"),
        ((TrajectoryRecord,), (), "was not finished"),
        ((*PATHS, ObjectMapRecord), PICTURES, "no ground truth"),
    ],
)
def test_page_leaves_out_pictures_of_what_is_missing(
    left_out: tuple[type, ...], missing: tuple[str, ...], reason: str
) -> None:
    page = page_of(without(*left_out))
    assert [name for name in PICTURES if f'<img alt="{name}"' not in page] == list(missing)
    assert reason in text_of(page)
