from pathlib import Path

import pytest

from slam.common.config import Config, load_config
from slam.common.config_tree import changed_settings, load_tree, settings_of, to_toml
from slam.common.errors import ConfigurationError
from slam.simulation.config import SimulationConfig

OVERRIDES = (
    "keyframe.distance_m=1.5",
    "loop_closure.enabled=false",
    "calibration.odometry.climb=0.1",
    "calibrate=false",
)
NAMES = ('labels.rename.cone="traffic cone"', 'labels.drop=["a b"]', 'topics.detections="/left,/right"')


def written(folder: Path, text: str) -> Path:
    path = folder / "settings.toml"
    path.write_text(text, encoding="utf-8")
    return path


def refusal(path: Path | None, *overrides: str) -> str:
    with pytest.raises(ConfigurationError) as caught:
        load_config(path, overrides)
    return str(caught.value)


def test_flag_wins_over_file_wins_over_default(tmp_path: Path) -> None:
    path = written(tmp_path, "[keyframe]\ndistance_m = 3\n[loop_closure]\ntop_k = 9\n")
    config = load_config(path, ["keyframe.distance_m=4", "keyframe.distance_m=.5"])
    assert config.keyframe.distance_m == 0.5
    assert config.loop_closure.top_k == 9
    assert config.loop_closure.max_candidates == Config().loop_closure.max_candidates


@pytest.mark.parametrize("overrides", [(), OVERRIDES, NAMES])
def test_toml_reads_back(tmp_path: Path, overrides: tuple[str, ...]) -> None:
    config = load_config(None, overrides)
    assert load_config(written(tmp_path, to_toml(config))) == config


def test_every_setting_has_a_meaning() -> None:
    for setting in [*settings_of(Config()), *settings_of(SimulationConfig())]:
        assert setting.meaning, setting.key
        assert setting.allowed, setting.key


def test_changed_settings_are_those_that_differ_from_the_defaults() -> None:
    assert changed_settings(Config()) == ""
    changed = changed_settings(load_config(None, OVERRIDES))
    assert changed == (
        "calibrate=false, keyframe.distance_m=1.5, loop_closure.enabled=false, calibration.odometry.climb=0.1"
    )


@pytest.mark.parametrize("text", ["a = " + "[" * 5000, "a = " + "9" * 5000, "[" + "a." * 5000 + "a]\nb = 1"])
def test_files_that_are_nested_or_long_beyond_reason_are_refused(tmp_path: Path, text: str) -> None:
    assert refusal(written(tmp_path, text))


@pytest.mark.parametrize("value", ["[" * 5000, "9" * 5000, "1e308", "5e-324"])
def test_values_that_are_nested_or_long_beyond_reason_are_refused(value: str) -> None:
    assert refusal(None, f"keyframe.distance_m={value}")


def test_a_file_may_begin_with_a_byte_order_mark(tmp_path: Path) -> None:
    path = tmp_path / "settings.toml"
    path.write_bytes(b"\xef\xbb\xbf[keyframe]\ndistance_m = 1.5\n")
    assert load_config(path).keyframe.distance_m == 1.5


@pytest.mark.parametrize(
    ("override", "told"),
    [
        ("keyframe.distance=1", "did you mean keyframe.distance_m?"),
        ("keyframe.distance_m.x=1", "a valid number"),
        ("zzz.q=1", "'dslam config' lists the keys"),
        ("keyframe.distance_m=-1", "greater than 0: travel since the last keyframe"),
        ("keyframe.distance_m=far", "a valid number"),
        ("keyframe.distance_m=nan", "a finite number"),
        ("calibration.detection.yaw_deg=181", "less than or equal to 180"),
        ("loop_closure.top_k=1.5", "a valid integer"),
        ("loop_closure.enabled=guess", "a valid boolean"),
        ("keyframe=2", "keyframe=2 is not allowed; Input should be an object"),
        ("seed", "expected key=value"),
        ("=3", "expected key=value"),
        ("keyframe..distance_m=3", "there is no"),
        ("loop_closure.top_k=4294967296", "numbers other than 0 must be from"),
        ("calibration.odometry.tilt_sigma=1e9", "less than or equal to 1000"),
    ],
)
def test_refusals_name_flag_and_remedy(override: str, told: str) -> None:
    message = refusal(None, override)
    assert message.startswith("--set")
    assert told in message
    assert "\n" not in message


@pytest.mark.parametrize(
    ("text", "told"),
    [
        ("[keyframe]\ndistance_mm = 3\n", "did you mean keyframe.distance_m?"),
        ("[keyfame]\ndistance_m = 3\n", "did you mean keyframe.distance_m?"),
        ("keyframe = 3\n", "keyframe=3 is not allowed; Input should be an object"),
        ("[calibration.detection]\nyaw_deg = 200\n", "less than or equal to 180"),
        ("seed = \n", "is not TOML"),
        ("[loop_closure]\ntop_k = 2026-01-01\n", "a valid integer"),
    ],
)
def test_refusals_name_the_file(tmp_path: Path, text: str, told: str) -> None:
    path = written(tmp_path, text)
    message = refusal(path)
    assert str(path) in message
    assert told in message


def test_what_is_missing_is_told_with_who_began_the_branch(tmp_path: Path) -> None:
    with pytest.raises(ConfigurationError, match=r"^--set: kidnap\.from_m is missing"):
        load_tree(SimulationConfig, None, ["kidnap.gap_s=30"])
    path = written(tmp_path, "[kidnap]\ngap_s = 30\n")
    with pytest.raises(ConfigurationError) as caught:
        load_tree(SimulationConfig, path, ["sensor.dropout=0.1"])
    assert str(caught.value).startswith(f"{path}: kidnap.from_m is missing")


def test_a_file_without_end_is_no_file_of_settings(tmp_path: Path) -> None:
    path = tmp_path / "endless.toml"
    with path.open("wb") as stream:
        stream.truncate(10**12)  # of no blocks
    assert "endless.toml has more than 10000000 characters" in refusal(path)
