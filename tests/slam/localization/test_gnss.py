"""Fixes of satellites: a prior in a map, and where on earth a map lies."""

from collections import Counter
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from logs.decoders.decode import decode
from logs.errors import InvalidRecordError
from logs.messages import FloatArray, GeodeticFix, Odometry, TrajectoryRecord
from logs.reader import LogReader
from logs.selection import select_topics
from logs.writer import LogWriter
from slam.backend.factor_graph import FactorGraph
from slam.backend.factors import Edge, EdgeKind
from slam.common.config import Config
from slam.common.geometry import apply, invert, transform_from_xyz_yaw
from slam.common.georeference import Georeference
from slam.evaluation.inputs.records import read_records
from slam.evaluation.metrics.alignment import align_yaw_translation
from slam.formats.trajectories import write_geodetic
from slam.localization.gnss import GnssPrior, LaidFixes, find_georeference, tie_to_fixes
from slam.log_mapper import LOCATION
from slam.object_map.map_io import load_map
from slam.odometry.keyframe import Keyframe
from slam.odometry.pose import OdometryPose
from slam.place_recognition.initial_pose import GATE_SIGMAS
from slam.replay import replay
from slam.system import Slam
from tests.helpers.ros2_logs import encoded, header
from tests.helpers.short_drives import Entry, drive, write_log

SECOND = 10**9
TRUE = Georeference(60.17, 24.94, 12.0, 0.7)


def fixes_of(positions: FloatArray, sigma_m: float = 2.0, *, seed: int = 1) -> list[GeodeticFix]:
    """Fixes once a second of a robot at ``positions`` (N, 3) m."""
    noise = np.random.default_rng(seed).normal(0.0, sigma_m, positions.shape)
    places = TRUE.to_geodetic(positions + noise).tolist()
    return [
        GeodeticFix(i * SECOND, "gps", latitude, longitude, altitude_m, sigma_m**2 * np.eye(3))
        for i, (latitude, longitude, altitude_m) in enumerate(places)
    ]


def path(step_m: float = 3.0) -> TrajectoryRecord:
    count = 200
    yaw = 0.02 * np.arange(count)
    xyz = np.cumsum(step_m * np.stack([np.cos(yaw), np.sin(yaw), np.zeros(count)], axis=1), axis=0)
    stamps_ns = SECOND * np.arange(count)
    return TrajectoryRecord(0, "map", stamps_ns, transform_from_xyz_yaw(xyz, yaw))


POSITIONS = path().T_map_body[:, :3, 3]


def far_off(fixes: list[GeodeticFix], share: float) -> list[GeodeticFix]:
    """A ``share`` of the fixes reflected by the same wall: 300 m off, though they say 2 m."""
    chosen = np.random.default_rng(2).random(len(fixes)) < share
    return [
        replace(f, latitude_deg=f.latitude_deg + 0.0027) if is_off else f
        for f, is_off in zip(fixes, chosen, strict=True)
    ]


def off_m(found: Georeference | None) -> FloatArray:
    """How far (N, 3) m positions of the path are from where they are on earth."""
    return np.abs(TRUE.to_map(found.to_geodetic(POSITIONS)) - POSITIONS)


@pytest.mark.parametrize("share", [0.0, 0.3])
def test_find_georeference_finds_the_place_of_a_map_with_outliers(share: float) -> None:
    found = find_georeference(path(), far_off(fixes_of(POSITIONS), share))
    assert off_m(found).max() < 1.0
    assert abs(found.yaw_rad - TRUE.yaw_rad) < 0.01


def test_few_good_fixes_weigh_more_than_many_bad_ones() -> None:
    good, bad = fixes_of(POSITIONS, 0.1), fixes_of(POSITIONS, 20.0, seed=3)
    found = find_georeference(path(), [bad[i] if i % 40 else good[i] for i in range(len(good))])
    assert off_m(found)[:, :2].max() < 0.3


def test_a_path_too_short_or_few_fixes_tell_nothing() -> None:
    for step_m, is_long in ((0.12, False), (0.15, True)):  # three times as long as the fixes err
        short = path(step_m=step_m)
        assert (find_georeference(short, fixes_of(short.T_map_body[:, :3, 3])) is not None) == is_long
    assert find_georeference(path(), fixes_of(POSITIONS)[:4]) is None
    for off_ns in (-(10**15), 10**15):  # not of the drive
        fixes = [replace(fix, stamp_ns=fix.stamp_ns + off_ns) for fix in fixes_of(POSITIONS)]
        assert find_georeference(path(), fixes) is None


def test_latest_fix_that_most_agree_with_is_the_prior() -> None:
    prior, found = GnssPrior(TRUE), None
    for i, fix in enumerate(far_off(fixes_of(POSITIONS[:20]), 0.3)):
        found = prior.add(fix, 3.0 * i)
    reach_m = GATE_SIGMAS * found.sigma_m + abs(3.0 * 19 - found.at_travel_m)
    assert np.linalg.norm(found.position - POSITIONS[19, :2]) < reach_m < 30.0


def test_fixes_without_covariance_are_no_prior() -> None:
    (fix,) = fixes_of(POSITIONS[:1])
    assert GnssPrior(TRUE).add(replace(fix, covariance=None), 0.0) is None


def nav_sat_fix(**fields: object) -> dict[str, object]:
    values = {"header": header(SECOND, "gps"), "latitude": 60.1, "longitude": 24.9, "altitude": float("nan")}
    return {**values, "position_covariance": np.diag([1.0, 4.0, 9.0]), "position_covariance_type": 2, **fields}


def test_nav_sat_fix() -> None:
    def decoded(**fields: object) -> tuple[GeodeticFix, ...]:
        raw = encoded(("/fix", "sensor_msgs/msg/NavSatFix", 5 * SECOND, nav_sat_fix(**fields)))
        return decode(raw, "gnss", Counter())  # type: ignore[return-value, arg-type]

    (fix,) = decoded()
    assert (fix.stamp_ns, fix.frame_id, fix.latitude_deg, fix.longitude_deg) == (SECOND, "gps", 60.1, 24.9)
    assert fix.altitude_m == 0.0
    np.testing.assert_array_equal(fix.covariance, np.diag([1.0, 4.0, 9.0]))
    assert decoded(position_covariance_type=0)[0].covariance is None
    assert decoded(status={"status": -1, "service": 1}) == ()
    with pytest.raises(InvalidRecordError, match="not a valid latitude and longitude"):
        decoded(latitude=float("nan"))


def test_location_fix_comes_back_as_written(tmp_path: Path) -> None:
    written = fixes_of(np.zeros((2, 3)))
    with LogWriter(tmp_path / "log.mcap") as writer:
        writer.write("/fix", written[0])
        writer.write("/fix", replace(written[1], covariance=None))
    with LogReader(tmp_path / "log.mcap") as reader:
        selection = select_topics(reader.topics(), needed=())
        assert selection.topics_of("gnss") == ("/fix",)
        found = [entry.record for entry in reader.records(selection)]
    assert found[0].latitude_deg == written[0].latitude_deg
    np.testing.assert_array_equal(found[0].covariance, written[0].covariance)
    assert found[1].covariance is None


def with_fixes() -> list[Entry]:
    """A drive with a receiver that sees the robot once in five poses."""
    entries = drive()
    poses = [entry for entry in entries if entry[0] == "/ground_truth"][::5]
    fixes = far_off(fixes_of(np.array([pose.T_world_body[:3, 3] for _, _, pose in poses]), 0.3), 0.2)
    made = [("/fix", at, replace(fix, stamp_ns=pose.stamp_ns)) for fix, (_, at, pose) in zip(fixes, poses, strict=True)]
    return sorted([*entries, *made], key=lambda entry: entry[1])


def test_a_robot_that_stands_has_no_heading_on_earth() -> None:
    standing = replace(path(), T_map_body=np.tile(np.eye(4), (200, 1, 1)))
    assert find_georeference(standing, fixes_of(np.zeros((200, 3)))) is None


def test_covariances_of_zeros_are_unknown() -> None:
    unknown = [replace(fix, covariance=np.zeros((3, 3))) for fix in fixes_of(POSITIONS)]
    assert off_m(find_georeference(path(), unknown)).max() < 1.0


def test_fixes_at_a_pole_tell_nothing() -> None:
    assert find_georeference(path(), [replace(fix, latitude_deg=90.0) for fix in fixes_of(POSITIONS)]) is None


def test_fixes_of_a_drive_are_edges_of_its_graph_from_the_first_keyframe() -> None:
    slam = Slam(Config())
    for _, _, record in with_fixes():
        if isinstance(record, Odometry | GeodeticFix):
            slam.process(record)
    graph = slam.finish().graph
    starts = [
        start for (start, _), kind in zip(graph.edge_keyframe_ids, graph.edge_kinds, strict=True) if kind == "gnss"
    ]
    assert slam.counters["gnss_fixes_used"] == len(starts) > 5
    assert set(starts) == {graph.keyframe_ids[0]}


@pytest.mark.slow
def test_a_drive_with_fixes_tells_where_on_earth_it_was(tmp_path: Path) -> None:
    source = write_log(tmp_path / "in.mcap", with_fixes())
    replay(source, tmp_path / "out.mcap", Config())
    with LogReader(tmp_path / "out.mcap") as reader:
        found = Georeference.from_json(reader.metadata()["dslam_georeference"]["georeference"])
        assert LOCATION not in {info.topic for info in reader.topics()}
    records = read_records(tmp_path / "out.mcap")
    final = records.final_path
    write_geodetic(tmp_path / "places.csv", final.stamps_ns, final.T_world_body, found)
    places = np.loadtxt(tmp_path / "places.csv", delimiter=",", skiprows=1)[:, 1:]
    truth = records.true_path.positions
    off = TRUE.to_map(places)[:, None] - truth[None]
    assert np.linalg.norm(off, axis=2).min(axis=1).max() < 1.0


@pytest.mark.slow
def test_a_saved_map_with_a_place_on_earth_locates_later_drives(tmp_path: Path) -> None:
    source = write_log(tmp_path / "in.mcap", with_fixes())
    replay(source, tmp_path / "first.mcap", Config(), map_path=tmp_path / "map.mcap")
    saved = load_map(tmp_path / "map.mcap")
    placed = replace(saved, metadata={**saved.metadata, "georeference": TRUE.to_json()})
    for prior_map, is_located in ((saved, False), (placed, True)):
        replay(source, tmp_path / "second.mcap", Config(), prior_map=prior_map, extend=False)
        with LogReader(tmp_path / "second.mcap") as reader:
            assert (LOCATION in {info.topic for info in reader.topics()}) == is_located


def ate_m(graph: FactorGraph, true: FloatArray) -> float:
    positions = graph.poses()[:, :3, 3]
    off = apply(align_yaw_translation(positions, true[:, :3, 3]), positions) - true[:, :3, 3]
    return float(np.sqrt(np.mean(np.sum(off**2, axis=1))))


class TestEdgesOfFixes:
    """A drive around a square whose odometry turns too much, with an antenna 2 m ahead and 1 m left of the body."""

    SIDE, STEPS = 25, 200

    def true_poses(self) -> FloatArray:
        yaw = 0.5 * np.pi * (np.arange(self.STEPS) // self.SIDE)
        steps = 2.0 * np.stack([np.cos(yaw), np.sin(yaw), np.zeros(self.STEPS)], axis=1)
        return transform_from_xyz_yaw(np.cumsum(steps, axis=0) - steps[0], yaw)

    def graph(self, true: FloatArray) -> tuple[FactorGraph, list[Keyframe]]:
        graph, keyframes, covariance = FactorGraph(), list[Keyframe](), np.diag([1e-4] * 3 + [1e-3] * 3)
        graph.add_keyframe(0, true[0])
        turn = transform_from_xyz_yaw(np.zeros(3), 0.003)
        for i, T in enumerate(true):
            keyframes.append(Keyframe(i, OdometryPose(i * SECOND, T, 2.0 * i, 0, 2.0), T))
            if i:
                step = invert(true[i - 1]) @ T @ turn
                graph.add_next_keyframe(Edge(i - 1, i, step, covariance, EdgeKind.ODOMETRY))
        return graph, keyframes

    def error_m(self, errors_m: FloatArray, *, covariance: FloatArray | None = None) -> tuple[float, float]:
        """RMS errors of the keyframes, aligned, without and with fixes that are ``errors_m`` (N, 2) off."""
        true = self.true_poses()
        graph, keyframes = self.graph(true)
        graph.update()
        before = ate_m(graph, true)
        antenna = apply(true, np.array([[2.0, 1.0, 0.0]]))[:, 0]
        antenna[:, :2] += errors_m
        fixes = [
            GeodeticFix(i * SECOND, "gnss", latitude, longitude, altitude_m, covariance)
            for i, (latitude, longitude, altitude_m) in enumerate(TRUE.to_geodetic(antenna).tolist())
        ]
        stamps_ns = SECOND * np.arange(len(true), dtype=np.int64)
        used = tie_to_fixes(graph, keyframes, lambda: TrajectoryRecord(0, "map", stamps_ns, graph.poses()), fixes)
        assert used == len(true) - 1
        return before, ate_m(graph, true)

    def test_exact_fixes_hold_the_whole_drive(self) -> None:
        assert self.error_m(np.zeros((self.STEPS, 2)))[1] < 0.1

    @pytest.mark.parametrize("covariance", [None, 1e-4 * np.eye(3)])
    @pytest.mark.parametrize("seed", [4, 6])
    def test_fixes_of_an_antenna_correct_the_drift_whatever_they_claim(
        self, seed: int, covariance: FloatArray | None
    ) -> None:
        noise = np.random.default_rng(seed).normal(0.0, 0.5, (self.STEPS, 2))
        before, after = self.error_m(noise, covariance=covariance)
        assert before > 4.0
        assert after < 0.3

    def test_outliers_do_not_move_the_map(self) -> None:
        noise = np.random.default_rng(4).normal(0.0, 0.5, (self.STEPS, 2))
        noise[::5] += [30.0, -40.0]
        assert self.error_m(noise)[1] < 0.3


def test_fixes_whose_errors_last_weigh_less() -> None:
    rng = np.random.default_rng(5)
    white = rng.normal(0.0, 2.0, (20000, 2))
    lasting = np.zeros_like(white)
    for i in range(1, len(lasting)):
        lasting[i] = 0.9 * lasting[i - 1] + np.sqrt(1.0 - 0.9**2) * white[i]
    stamps_ns, sigmas_m = np.arange(20000, dtype=np.int64), np.ones(20000)
    variances = [LaidFixes(TRUE, np.eye(4), stamps_ns, sigmas_m, errors_m).variance() for errors_m in (white, lasting)]
    assert variances[0] == pytest.approx(4.0, rel=0.03)
    assert variances[1] == pytest.approx(4.0 * 1.9 / 0.1, rel=0.2)
