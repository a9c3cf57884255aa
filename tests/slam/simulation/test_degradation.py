from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from logs.messages import (
    ObjectDetections,
)
from slam.common.errors import ConfigurationError, SimulationError
from slam.simulation.degradation import (
    DegradationConfig,
    DegradationStreams,
    Donors,
    choose_labels,
    degrade_detections,
    make_degradation,
)
from tests.slam.simulation.degraded import (
    COUNT,
    EACH,
    LABELS,
    SCANS,
    T_BODY_SENSOR,
    assert_true_ids_fit,
    by_track,
    degrade,
    drive,
    read,
    scan,
    tracks,
    write,
)

pytestmark = pytest.mark.slow


@pytest.fixture(scope="module")
def log(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write(tmp_path_factory.mktemp("log") / "log.mcap", drive(rng=np.random.default_rng(11)))


@pytest.fixture(scope="module")
def before(log: Path) -> dict[str, list[Any]]:
    return read(log)


class TestDetections:
    def test_dropout(self, log: Path) -> None:
        degraded = degrade(log, dropout=0.3)
        kept = np.array([len(d.labels) for d in degraded.records["/detections"]])
        assert kept.sum() / COUNT == pytest.approx(0.7, abs=4 * np.sqrt(0.21 / COUNT))
        assert kept.var() == pytest.approx(EACH * 0.21, rel=0.5)  # independent of one another
        assert degraded.summary.counts["kept"] == kept.sum() == COUNT - degraded.summary.counts["dropped_out"]
        assert_true_ids_fit(degraded.records)

    def test_dropout_of_all_leaves_empty_scans(self, log: Path) -> None:
        degraded = degrade(log, dropout=1.0)
        assert [len(d.labels) for d in degraded.records["/detections"]] == [0] * SCANS
        assert [t.object_ids for t in degraded.records["/ground_truth/detections"]] == [()] * SCANS

    def test_position_noise_and_its_covariance(self, log: Path, before: dict[str, list[Any]]) -> None:
        degraded = degrade(log, position_noise_m=0.3)
        noise = np.concatenate(
            [
                b.positions - a.positions
                for a, b in zip(before["/detections"], degraded.records["/detections"], strict=True)
            ]
        )
        assert noise.mean(axis=0) == pytest.approx(np.zeros(3), abs=4 * 0.3 / np.sqrt(COUNT))
        assert np.cov(noise.T) == pytest.approx(0.09 * np.eye(3), abs=5 * 0.09 * np.sqrt(2 / COUNT))
        covariances = degraded.records["/detections"][0].covariances
        assert covariances[1::2] == pytest.approx(np.tile((0.04 + 0.09) * np.eye(3), (EACH // 2, 1, 1)))
        assert not covariances[::2].any()  # unknown before, unknown now

    def test_label_confusion(self, log: Path, before: dict[str, list[Any]]) -> None:
        degraded = degrade(log, label_confusion=0.4)
        old, new = by_track(before), by_track(degraded.records)
        became = [(old[track][1], new[track][1]) for track in old if old[track][1] != new[track][1]]
        assert len(became) / COUNT == pytest.approx(0.4, abs=4 * np.sqrt(0.24 / COUNT))
        assert degraded.summary.counts["relabelled"] == len(became)
        for label in LABELS:
            others = [new for old, new in became if old == label]
            for other in set(LABELS) - {label}:
                assert others.count(other) / len(others) == pytest.approx(0.5, abs=4 * 0.5 / np.sqrt(len(others)))

    def test_false_positives(self, log: Path) -> None:
        mean = 4.0
        degraded = degrade(log, false_positives=mean, field_of_view_deg=180.0)
        assert_true_ids_fit(degraded.records)
        counts = np.array([t.object_ids.count("") for t in degraded.records["/ground_truth/detections"]])
        assert counts.mean() == pytest.approx(mean, abs=4 * np.sqrt(mean / SCANS))
        assert counts.var() == pytest.approx(mean, rel=0.4)
        assert degraded.summary.counts["false_positives"] == counts.sum()
        real, false = self.split(degraded.records)
        total = len(false["positions"])
        ranges_m = np.hypot(*false["positions"][:, :2].T)
        reach_m = np.percentile(np.hypot(*real["positions"][:, :2].T), 95.0)
        assert ranges_m.max() <= reach_m + 1e-9
        # Even over the half disc: the squared range is uniform, and all of it is ahead.
        assert (ranges_m**2).mean() == pytest.approx(0.5 * reach_m**2, abs=4 * reach_m**2 / np.sqrt(12 * total))
        assert (false["positions"][:, 0] >= -1e-9).all()
        assert false["positions"][:, 1].mean() == pytest.approx(0.0, abs=2.0 * reach_m / np.sqrt(total))
        assert set(np.round(false["positions"][:, 2], 9)) <= set(np.round(real["positions"][:, 2], 9))
        share = np.mean(real["labels"] == "lamp")
        assert np.mean(false["labels"] == "lamp") == pytest.approx(share, abs=4 * 0.5 / np.sqrt(total))

    @staticmethod
    def split(records: dict[str, list[Any]]) -> tuple[dict[str, Any], dict[str, Any]]:
        """Detections of the log, and false ones, with positions from the sensor in the body's axes."""
        is_false = np.array([not track for d in records["/detections"] for track in d.track_ids])
        positions = np.concatenate([d.positions for d in records["/detections"]]) @ T_BODY_SENSOR[:3, :3].T
        labels = np.array([label for d in records["/detections"] for label in d.labels])
        real, false = ({"positions": positions[rows], "labels": labels[rows]} for rows in (~is_false, is_false))
        return real, false

    def test_false_positives_in_a_scan_that_saw_nothing(self) -> None:
        rng = np.random.default_rng(3)
        donors = Donors.of(scan(0, rng))
        nothing = ObjectDetections(9, "lidar", np.zeros((0, 3)), (), np.zeros(0))
        config = DegradationConfig(false_positives=30.0)
        degraded = degrade_detections(nothing, np.eye(3), config, LABELS, donors, DegradationStreams.of_seed(0))
        assert degraded.false_positive_count == len(degraded.detections.labels) > 10
        assert (degraded.detections.stamp_ns, degraded.detections.frame_id) == (9, "lidar")
        assert degraded.detections.covariances is not None

    @pytest.mark.parametrize("with_transform", [True, False])
    @pytest.mark.parametrize("angle_deg", [90.0, 180.0])
    def test_field_of_view_is_that_of_the_body(self, tmp_path: Path, angle_deg: float, with_transform: bool) -> None:
        records = drive(rng=np.random.default_rng(5), with_transform=with_transform)
        degraded = degrade(write(tmp_path / "log.mcap", records), field_of_view_deg=angle_deg)
        kept = set(tracks(degraded.records))
        R_body_sensor = T_BODY_SENSOR[:3, :3] if with_transform else np.eye(3)
        for _, record in records:
            if isinstance(record, ObjectDetections):
                x, y = (record.positions @ R_body_sensor.T)[:, :2].T
                ahead = np.abs(np.rad2deg(np.arctan2(y, x))) <= 0.5 * angle_deg
                assert [track in kept for track in record.track_ids or ()] == ahead.tolist()
        assert_true_ids_fit(degraded.records)

    def test_range_is_horizontal_and_from_the_sensor(self, log: Path, before: dict[str, list[Any]]) -> None:
        degraded = degrade(log, max_range_m=20.0)
        ranges_m = {track: np.hypot(*position[:2]) for track, (position, _, _) in by_track(before).items()}
        assert set(tracks(degraded.records)) == {track for track, range_m in ranges_m.items() if range_m <= 20.0}

    @pytest.mark.parametrize(
        "options",
        [
            {"keep_labels": ("lamp", "tree")},
            {"drop_labels": ("sign",)},
            {"keep_labels": LABELS, "drop_labels": ("sign",)},
        ],
    )
    def test_labels(self, log: Path, before: dict[str, list[Any]], options: dict[str, Any]) -> None:
        degraded = degrade(log, **options, label_confusion=0.5)
        assert {label for d in degraded.records["/detections"] for label in d.labels} == {"lamp", "tree"}
        wanted = {track for track, (_, label, _) in by_track(before).items() if label != "sign"}
        assert set(tracks(degraded.records)) == wanted

    def test_one_degradation_leaves_the_chances_of_the_others(self, log: Path) -> None:
        alone = degrade(log, dropout=0.5)
        kept = tracks(alone.records)
        with_noise = degrade(log, dropout=0.5, position_noise_m=0.2, label_confusion=0.2, reversed=True)
        assert sorted(tracks(with_noise.records)) == sorted(kept)
        in_view = degrade(log, dropout=0.5, field_of_view_deg=120.0)
        assert set(tracks(in_view.records)) < set(kept)
        noise = by_track(degrade(log, position_noise_m=0.2).records)
        for track, (position, _, _) in by_track(with_noise.records).items():
            assert position == pytest.approx(noise[track][0])

    def test_sizes_and_scores_stay_with_their_detections(self, log: Path) -> None:
        degraded = degrade(log, dropout=0.5)
        for detections in degraded.records["/detections"]:
            assert detections.sizes[:, 0] == pytest.approx(detections.positions[:, 0] ** 2)


class TestRefusals:
    @pytest.mark.parametrize(
        "options",
        [
            {"dropout": 1.1}, {"dropout": -0.1}, {"dropout": float("nan")}, {"label_confusion": 2.0},
            {"position_noise_m": -1.0}, {"position_noise_m": float("inf")}, {"field_of_view_deg": 0.0},
            {"field_of_view_deg": 361.0}, {"max_range_m": 0.0}, {"max_range_m": float("nan")},
            {"false_positives": -1.0}, {"odometry_yaw_noise": -0.1}, {"time_offset_s": float("inf")}, {"blur": 1.0},
        ],
    )  # fmt: skip
    def test_values_out_of_range(self, options: dict[str, float]) -> None:
        with pytest.raises(ConfigurationError, match=next(iter(options))):
            make_degradation(options)

    def test_labels_that_cannot_be(self) -> None:
        with pytest.raises(SimulationError, match=r"'car'.*lamp, sign, tree"):
            choose_labels(LABELS, DegradationConfig(keep_labels=("car",)))
        with pytest.raises(SimulationError, match="no label is left"):
            choose_labels(LABELS, DegradationConfig(drop_labels=LABELS))
        with pytest.raises(SimulationError, match="only label"):
            choose_labels(LABELS, DegradationConfig(keep_labels=("lamp",), label_confusion=0.1))
