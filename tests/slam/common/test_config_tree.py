from __future__ import annotations

from pathlib import Path

import pytest

from slam.common.config import Config, load_config
from slam.common.config_tree import RENAMED, changes, settings_of, to_toml
from slam.common.errors import ConfigurationError
from slam.simulation.config import SimulationConfig, load_simulation_config

OVERRIDES = (
    "keyframe.distance_m=1.5",
    "registration.six_dof=true",
    "calibration.odometry.sources=2",
    "calibrate=false",
)


def written(folder: Path, text: str) -> Path:
    path = folder / "settings.toml"
    path.write_text(text, encoding="utf-8")
    return path


def test_without_anything_the_defaults() -> None:
    assert load_config() == Config()
    assert load_simulation_config() == SimulationConfig()


def test_flag_wins_over_file_wins_over_default(tmp_path: Path) -> None:
    path = written(tmp_path, "[keyframe]\ndistance_m = 3\n[loop_closure]\ntop_k = 9\n")
    config = load_config(path, ["keyframe.distance_m=4", "keyframe.distance_m=5"])
    assert config.keyframe.distance_m == 5.0
    assert config.loop_closure.top_k == 9
    assert config.loop_closure.max_candidates == Config().loop_closure.max_candidates


@pytest.mark.parametrize("overrides", [(), OVERRIDES])
def test_toml_reads_back(tmp_path: Path, overrides: tuple[str, ...]) -> None:
    config = load_config(None, overrides)
    assert load_config(written(tmp_path, to_toml(config))) == config


def test_toml_of_the_simulation_reads_back(tmp_path: Path) -> None:
    config = load_simulation_config(None, ["kidnap.from_m=100", "kidnap.to_m=300", "sensor.occlusion=false"])
    assert config.kidnap is not None
    assert load_simulation_config(written(tmp_path, to_toml(config))) == config


def test_every_setting_has_a_meaning() -> None:
    for setting in [*settings_of(Config()), *settings_of(SimulationConfig())]:
        assert setting.meaning, setting.key
        assert setting.allowed, setting.key


def test_changes_names_what_is_not_the_default() -> None:
    assert changes(Config(), Config().model_dump_json()) == []
    changed = changes(Config(), load_config(None, OVERRIDES).model_dump_json())
    assert changed == [
        "calibrate=false",
        "keyframe.distance_m=1.5",
        "registration.six_dof=true",
        "calibration.odometry.sources=2",
    ]
    assert changes(Config(), "no json") == ["unreadable"]


@pytest.mark.parametrize("text", ["a = " + "[" * 5000, "a = " + "9" * 5000, "[" + "a." * 5000 + "a]\nb = 1"])
def test_files_that_are_nested_or_long_beyond_reason_are_refused(tmp_path: Path, text: str) -> None:
    path = tmp_path / "settings.toml"
    path.write_text(text)
    with pytest.raises(ConfigurationError):
        load_config(path)


@pytest.mark.parametrize("value", ["[" * 5000, "9" * 5000, "[" * 300 + "]" * 300, "1e308", "5e-324"])
def test_values_that_are_nested_or_long_beyond_reason_are_refused(value: str) -> None:
    with pytest.raises(ConfigurationError):
        load_config(None, [f"keyframe.distance_m={value}"])


def test_a_file_may_begin_with_a_byte_order_mark(tmp_path: Path) -> None:
    path = tmp_path / "settings.toml"
    path.write_bytes(b"\xef\xbb\xbf[keyframe]\ndistance_m = 1.5\n")
    assert load_config(path).keyframe.distance_m == 1.5


@pytest.mark.parametrize(
    ("override", "told"),
    [
        ("keyframe.distance=1", "did you mean keyframe.distance_m?"),
        ("distance_m=1", "did you mean keyframe.distance_m?"),
        ("keyframe.distance_m.x=1", "a number > 0"),
        ("zzz.q=1", "'dslam config' lists the keys"),
        ("keyframe.distance_m=-1", "a number > 0"),
        ("keyframe.distance_m=far", "a number > 0"),
        ("keyframe.distance_m=true", "a number > 0"),
        ("keyframe.distance_m=nan", "a number > 0"),
        ("calibration.detection.yaw_deg=181", "a number >= -180 and <= 180"),
        ("loop_closure.top_k=1.5", "a whole number >= 1"),
        ("registration.six_dof=guess", "true or false"),
        ("keyframe=2", "keyframe is a branch"),
        ("seed", "expected key=value"),
        ("seed=", "expected key=value"),
        ("=3", "expected key=value"),
        ("keyframe..distance_m=3", "there is no"),
    ],
)
def test_refusals_name_flag_and_remedy(override: str, told: str) -> None:
    with pytest.raises(ConfigurationError) as caught:
        load_config(None, [override])
    message = str(caught.value)
    assert message.startswith("--set")
    assert told in message
    assert "\n" not in message


@pytest.mark.parametrize(
    ("text", "told"),
    [
        ("[keyframe]\ndistance_mm = 3\n", "did you mean keyframe.distance_m?"),
        ("[keyfame]\ndistance_m = 3\n", "did you mean keyframe.distance_m?"),
        ("keyframe = 3\n", "keyframe is a branch"),
        ("[calibration.detection]\nyaw_deg = 200\n", "a number >= -180 and <= 180"),
        ("seed = \n", "is not TOML"),
        ("[loop_closure]\ntop_k = 2026-01-01\n", "a whole number >= 1"),
    ],
)
def test_refusals_name_the_file(tmp_path: Path, text: str, told: str) -> None:
    path = written(tmp_path, text)
    with pytest.raises(ConfigurationError) as caught:
        load_config(path)
    assert str(path) in str(caught.value)
    assert told in str(caught.value)


def test_a_file_that_is_missing(tmp_path: Path) -> None:
    with pytest.raises(ConfigurationError, match="No such file"):
        load_config(tmp_path / "none.toml")


def test_a_bad_flag_over_a_good_file_blames_the_flag(tmp_path: Path) -> None:
    path = written(tmp_path, "[loop_closure]\ntop_k = 20\n")
    with pytest.raises(ConfigurationError, match=r"^--set"):
        load_config(path, ["loop_closure.top_k=-1"])


def test_what_is_missing_is_told_with_who_began_the_branch(tmp_path: Path) -> None:
    with pytest.raises(ConfigurationError, match=r"^--set: kidnap\.from_m is missing; it is a number > 0"):
        load_simulation_config(None, ["kidnap.gap_s=30"])
    path = written(tmp_path, "[kidnap]\ngap_s = 30\n")
    with pytest.raises(ConfigurationError) as caught:
        load_simulation_config(path, ["sensor.dropout=0.1"])
    assert str(caught.value).startswith(f"{path}: kidnap.from_m is missing")


@pytest.mark.parametrize(
    ("old", "told"),
    [
        ("calibration.enabled", "it was renamed to calibrate"),
        ("limits.chunk_mb", "it was renamed to memory_mb"),
        ("loop_closure.neighbours", "it was renamed to loop_closure.top_k"),
        ("association.confusion_distance_m", "it was renamed to calibration.objects.spacing_m"),
        ("odometry.yaw_sigma", "did you mean calibration.odometry.yaw_sigma?"),
        ("landmark.confirm_observations", "it is a constant now; 'dslam config' lists the keys"),
    ],
)
def test_an_old_name_is_refused_with_what_took_its_place(tmp_path: Path, old: str, told: str) -> None:
    branch, _, name = old.rpartition(".")
    for given in ((None, [f"{old}=3"]), (written(tmp_path, f"[{branch}]\n{name} = 3\n"),)):
        with pytest.raises(ConfigurationError) as caught:
            load_config(*given)
        assert str(caught.value).endswith(f"there is no '{old}'; {told}")
        assert "\n" not in str(caught.value)


def test_new_names_of_settings_exist_and_old_ones_do_not() -> None:
    keys = {setting.key for setting in settings_of(Config())}
    assert set(RENAMED.values()) <= keys
    assert keys.isdisjoint(RENAMED)


def test_a_renamed_setting_is_not_hinted_at_in_a_tree_without_it() -> None:
    with pytest.raises(ConfigurationError) as caught:
        load_simulation_config(None, ["limits.chunk_mb=5"])
    assert "renamed" not in str(caught.value)


def test_a_file_without_end_is_no_file_of_settings(tmp_path: Path) -> None:
    path = tmp_path / "endless.toml"
    with path.open("wb") as stream:
        stream.truncate(10**12)  # of no blocks
    with pytest.raises(ConfigurationError, match=r"endless\.toml has more than 10000000 characters"):
        load_config(path)


def test_whole_numbers_have_an_end() -> None:
    with pytest.raises(ConfigurationError, match=r"top_k=4294967296 is absurd; .* at most 2147483647"):
        load_config(overrides=["loop_closure.top_k=4294967296"])
    load_config(overrides=["loop_closure.top_k=2147483647"])


def test_noise_of_a_heading_has_an_end() -> None:
    with pytest.raises(ConfigurationError, match="tilt_sigma"):
        load_config(overrides=["calibration.odometry.tilt_sigma=1e9"])
