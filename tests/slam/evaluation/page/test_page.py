"""The page: whole, escaped, offline; and, in a browser, drawn and alive."""

from __future__ import annotations

import json
import re
import shutil
from dataclasses import replace
from html import unescape
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from logs.errors import UnwritableLogError
from logs.messages import (
    FactorGraphRecord,
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
from slam.evaluation.metrics.calibration import Consistency
from slam.evaluation.page.charts import draw_calibration
from slam.evaluation.page.page import compose_page, write_report
from slam.evaluation.page.traces import MAX_POINTS, label, thin
from slam.evaluation.report.picture import compose_picture
from tests.slam.evaluation.loops import closure, there_and_back
from tests.slam.evaluation.maps import object_map
from tests.slam.evaluation.results import graph

HOSTILE = '</script><b>O\'Brien & "sons"\n%{x}'
PATHS = (TrajectoryRecord, SlamPose, Odometry, GroundTruthPose)
CHARTS = ("map", "precision-recall", "error")
CHROMIUM, DRIVER = shutil.which("chromium"), shutil.which("chromedriver")
_CHART = re.compile(r'Plotly\.newPlot\(\s*"chart-([\w-]+)",\s*(\[.*?\]),\s*(\{.*?\}),\s*\{"displaylogo"', re.DOTALL)


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


def charts_of(page: str) -> dict[str, list[dict[str, Any]]]:
    """Traces of each chart by its name."""
    return {name: json.loads(data) for name, data, _ in _CHART.findall(page)}


def text_of(page: str) -> str:
    return unescape(re.sub(r"<[^>]*>", " ", re.sub(r"<script.*?</script>", "", page, flags=re.DOTALL)))


@pytest.fixture(scope="module")
def page() -> str:
    return page_of(collect_records(drive()), title=HOSTILE)


def test_page_holds_every_part(page: str) -> None:
    assert tuple(charts_of(page)) == CHARTS
    assert page.count("<h2>") == len(CHARTS) + 3  # calibration, all numbers, not measured
    text = " ".join(text_of(page).split())
    for part in ("66.67 %", "precision 66.67 % (2 true, 1 false)", "intra_revisit_std_m", "121 keyframes"):
        assert part in text
    for rule in evaluate(collect_records(drive())).protocol.describe().values():
        assert rule in text


def test_names_from_log_stay_text(page: str) -> None:
    assert "<b>O'" not in page
    assert 'O\'Brien & "sons"' in text_of(page)
    traces = [trace for chart in charts_of(page).values() for trace in chart]
    shown = [text for trace in traces for text in (trace["name"], *trace.get("text", ()))]
    assert any("&lt;/script&gt;&lt;b&gt;O'Brien" in text for text in shown)
    assert not any("<i>" in text or "</script>" in text for text in shown)
    assert not any("Brien" in trace.get("hovertemplate", "") for trace in traces)
    assert len(label("x" * 1000)) == 80


def test_page_needs_no_network(page: str) -> None:
    body = re.sub(r"<script.*?</script>", "", page, flags=re.DOTALL)
    assert not re.search(r"\b(src|href|srcset|action)=|url\(|@import", body)
    assert "default-src 'none'" in body


def test_same_input_gives_same_bytes(page: str, tmp_path: Path) -> None:
    records = collect_records(drive())
    write_report(tmp_path / "report.html", records, evaluate(records), title=HOSTILE)
    assert (tmp_path / "report.html").read_bytes() == page.encode()
    assert [path.name for path in tmp_path.iterdir()] == ["report.html"]
    with pytest.raises(UnwritableLogError, match="nowhere"):
        write_report(tmp_path / "nowhere" / "report.html", records, evaluate(records), title="")


@pytest.mark.parametrize(
    ("left_out", "missing", "reason"),
    [
        ((GroundTruthPose,), {"precision-recall", "error"}, "no ground truth"),
        ((LoopClosureRecord,), {"precision-recall"}, "no revisit, or no candidate"),
        ((FactorGraphRecord,), {"precision-recall"}, "no keyframes in the log"),
        ((TrajectoryRecord,), set(), "was not finished"),
        ((*PATHS, ObjectMapRecord), set(CHARTS), "neither"),
    ],
)
def test_page_names_what_is_missing(left_out: tuple[type, ...], missing: set[str], reason: str) -> None:
    page = page_of(without(*left_out))
    assert tuple(charts_of(page)) == tuple(name for name in CHARTS if name not in missing)
    assert reason in text_of(page)


def test_page_of_empty_log() -> None:
    assert charts_of(page_of(EvaluationRecords())) == {}


def test_charts_show_measurements() -> None:
    records = collect_records(drive())
    evaluation = evaluate(records)
    charts = charts_of(compose_page(records, evaluation, title=""))
    of_map = {trace["name"]: trace for trace in charts["map"]}
    missed = of_map["missed revisits (35)"]
    seconds = (np.array(evaluation.missed_ns) - records.true_poses[0].stamp_ns) * 1e-9
    np.testing.assert_allclose(missed["x"], 240.0 - seconds, atol=0.01)
    assert of_map["false loop closures (1)"]["x"] == [90.0, 0.0, None]
    assert of_map["tree (2)"]["x"] == [60.0, 110.0]
    dots = np.array(of_map["estimate by its error"]["marker"]["color"])
    assert np.sqrt(np.mean(dots**2)) == pytest.approx(evaluation.estimate.absolute.rmse_m, abs=2e-3)
    measured = (evaluation.odometry, evaluation.online, evaluation.estimate)
    for trace, errors in zip(charts["error"], measured, strict=True):
        assert np.sqrt(np.mean(np.square(trace["y"]))) == pytest.approx(errors.absolute.rmse_m, abs=1e-3)
    curve, mark = charts["precision-recall"]
    assert (mark["x"], mark["y"]) == ([round(2 / 37, 3)], [round(2 / 3, 3)])
    assert len(curve["x"]) > 1


def test_calibration_chart_tells_right_from_small_covariances() -> None:
    squares = np.random.default_rng(3).chisquare(3, size=20_000)
    parts = {"pose": Consistency(squares, 3), "landmark": Consistency(4.0 * squares, 3)}
    chart = draw_calibration(parts)
    _, right, small = chart["data"]
    np.testing.assert_allclose(right["y"], right["x"], atol=0.02)
    assert (small["y"][5:-5] < small["x"][5:-5] - 0.04).all()
    assert draw_calibration({}) is None


def test_thinning_keeps_ends_and_breaks() -> None:
    is_known = np.ones(100_000, dtype=np.bool_)
    is_known[54_321] = False
    rows = thin(is_known, 0.5)
    assert (rows[0], rows[-1]) == (0, 99_999)
    assert {54_320, 54_321, 54_322} <= set(rows.tolist())
    assert len(rows) <= 0.5 * MAX_POINTS + 3
    assert np.diff(rows).max() <= 41
    assert thin(np.ones(10, dtype=np.bool_)).tolist() == list(range(10))


def test_landmarks_are_thinned_by_class() -> None:
    labels = tuple("tree" if row % 3 else "pole" for row in range(12_000))
    many = object_map(tuple(map(str, range(12_000))), np.random.default_rng(0).normal(size=(12_000, 3)), labels)
    traces = charts_of(page_of(replace(without(*PATHS, LoopClosureRecord), object_map=many)))["map"]
    shown = {trace["name"]: len(trace["x"]) for trace in traces}
    assert shown == {"tree (8000)": MAX_POINTS * 2 // 3, "pole (4000)": MAX_POINTS // 3}


def kidnapped_drive() -> EvaluationRecords:
    """Carried off by 500 m half-way: lost, and found again."""
    truth = there_and_back()
    poses, stamps_ns = truth.T_world_body.copy(), truth.stamps_ns
    poses[120:, 0, 3] += 500.0
    known = replace(
        graph(stamps_ns[::2], poses[::2]),
        edge_keyframe_ids=np.array([[59, 60]]),
        edge_transforms=np.eye(4)[None],
        edge_covariances=np.eye(6)[None],
        edge_kinds=("discontinuity",),
    )
    states = ((0, "MAPPING", "info"), (120, "LOST", "warning"), (150, "RELOCALIZED", "info"))
    return collect_records(
        [
            *(("/ground_truth", GroundTruthPose(t, T)) for t, T in zip(stamps_ns, poses, strict=True)),
            *(("/odometry", Odometry(t, T)) for t, T in zip(stamps_ns, poses, strict=True)),
            ("/slam/trajectory_stamped", TrajectoryRecord(0, "map", stamps_ns, poses)),
            ("/slam/graph", known),
            *(("/slam/status", StatusRecord(int(stamps_ns[k]), state, level, "")) for k, state, level in states),
        ]
    )


def test_kidnapping_is_marked_and_breaks_the_lines() -> None:
    records = kidnapped_drive()
    charts = charts_of(page_of(records))
    traces = {trace["name"]: trace for trace in charts["map"]}
    for name in ("estimate", "odometry", "ground truth"):
        x = np.array(traces[name]["x"], dtype=float)
        assert np.isnan(x).sum() == 1, name
        assert np.nanmax(np.abs(np.diff(x))) < 5.0, name
    at = records.trajectory.T_map_body[:, 0, 3]
    assert traces["lost (1)"]["x"] == [at[120]]
    assert traces["found (1)"]["x"] == [at[150]]


def test_robot_without_first_fix_is_not_marked_as_lost() -> None:
    records = kidnapped_drive()
    first, *others = records.statuses
    found = replace(first, state="RELOCALIZED", stamp_ns=first.stamp_ns + 10**9)
    records = replace(records, statuses=(replace(first, state="LOST"), found, *others))
    evaluation = evaluate(records)
    picture = compose_picture(records, evaluation)
    assert (evaluation.results["relocalization"]["loss_count"], len(picture.lost), len(picture.found)) == (2, 1, 2)


@pytest.mark.skipif(not CHROMIUM or not DRIVER, reason="needs chromium and chromedriver (Debian: chromium-driver)")
@pytest.mark.slow
@pytest.mark.parametrize("width_px", [390, 1280])
def test_browser_draws_the_page(page: str, tmp_path: Path, width_px: int) -> None:
    from selenium import webdriver
    from selenium.webdriver.chrome.service import Service

    file = tmp_path / "report.html"
    file.write_text(page, encoding="utf-8")
    options = webdriver.ChromeOptions()
    options.binary_location = CHROMIUM or ""
    for flag in ("headless=new", "no-sandbox", "disable-gpu", "disable-dev-shm-usage", "hide-scrollbars"):
        options.add_argument(f"--{flag}")
    options.set_capability("goog:loggingPrefs", {"browser": "ALL", "performance": "ALL"})
    with webdriver.Chrome(options=options, service=Service(DRIVER)) as browser:
        metrics = {"width": width_px, "height": 900, "deviceScaleFactor": 1, "mobile": False}
        browser.execute_cdp_cmd("Emulation.setDeviceMetricsOverride", metrics)
        browser.get(file.as_uri())
        assert browser.execute_script("return document.documentElement.dataset.charts") == "drawn"
        assert browser.get_log("browser") == []
        events = [json.loads(entry["message"])["message"] for entry in browser.get_log("performance")]
        asked = {e["params"]["request"]["url"] for e in events if e["method"] == "Network.requestWillBeSent"}
        assert {url for url in asked if not url.startswith(("data:", "blob:", "chrome"))} == {file.as_uri()}
        assert browser.execute_script("return document.documentElement.scrollWidth") == width_px
        drawn = browser.execute_script(
            "return [...document.querySelectorAll('.js-plotly-plot')]"
            ".filter(c => c.querySelectorAll('svg .scatterlayer .trace').length).map(c => c.id)"
        )
        assert {name.removeprefix("chart-") for name in drawn} == set(CHARTS)
        buttons = browser.execute_script(
            "return [...document.querySelectorAll('.modebar-btn')].map(b => b.dataset.title)"
        )
        assert not [title for title in buttons if "Share" in title or "Cloud" in title or "link" in title.lower()]
