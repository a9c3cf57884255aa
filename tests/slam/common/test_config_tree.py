from __future__ import annotations

from pathlib import Path

import pytest

from slam.common.config import Config, load_config
from slam.common.config_tree import changes, settings_of, to_toml
from slam.common.errors import ConfigurationError
from slam.common.renamed_settings import RENAMED_SETTINGS
from slam.simulation.config import SimulationConfig, load_simulation_config

OVERRIDES = ("keyframe.distance_m=1.5", "factor_graph.observation_kernel=huber", "landmark.confirm_observations=3")


def written(folder: Path, text: str) -> Path:
    path = folder / "settings.toml"
    path.write_text(text, encoding="utf-8")
    return path


def test_without_anything_the_defaults() -> None:
    assert load_config() == Config()
    assert load_simulation_config() == SimulationConfig()


def test_flag_wins_over_file_wins_over_default(tmp_path: Path) -> None:
    path = written(tmp_path, "[keyframe]\ndistance_m = 3\nangle_deg = 30\n")
    config = load_config(path, ["keyframe.distance_m=4", "keyframe.distance_m=5"])
    assert config.keyframe.distance_m == 5.0
    assert config.keyframe.angle_deg == 30.0
    assert config.keyframe.interval_s == Config().keyframe.interval_s


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
        "keyframe.distance_m=1.5",
        "landmark.confirm_observations=3",
        'factor_graph.observation_kernel="huber"',
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
        ("keyframe.distance_m.x=1", "did you mean keyframe.distance_m?"),
        ("zzz.q=1", "'dslam config' lists the keys"),
        ("keyframe.distance_m=-1", "a number > 0"),
        ("keyframe.distance_m=far", "a number > 0"),
        ("keyframe.distance_m=true", "a number > 0"),
        ("keyframe.distance_m=nan", "a number > 0"),
        ("keyframe.angle_deg=181", "a number > 0 and <= 180"),
        ("landmark.confirm_observations=1.5", "a whole number >= 1"),
        ("factor_graph.observation_kernel=tukey", "one of none, huber, cauchy"),
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
        ("[keyframe]\nangle_deg = 200\n", "a number > 0 and <= 180"),
        ("seed = \n", "is no TOML"),
        ("[landmark]\nconfirm_observations = 2026-01-01\n", "a whole number >= 1"),
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
    path = written(tmp_path, "[keyframe]\nangle_deg = 20\n")
    with pytest.raises(ConfigurationError, match=r"^--set"):
        load_config(path, ["keyframe.angle_deg=400"])


def test_what_is_missing_is_told_with_who_began_the_branch(tmp_path: Path) -> None:
    with pytest.raises(ConfigurationError, match=r"^--set: kidnap\.from_m is missing; it is a number > 0"):
        load_simulation_config(None, ["kidnap.gap_s=30"])
    path = written(tmp_path, "[kidnap]\ngap_s = 30\n")
    with pytest.raises(ConfigurationError) as caught:
        load_simulation_config(path, ["sensor.dropout=0.1"])
    assert str(caught.value).startswith(f"{path}: kidnap.from_m is missing")


@pytest.mark.parametrize(("old", "new"), RENAMED_SETTINGS.items())
def test_a_renamed_setting_is_refused_with_its_new_name(tmp_path: Path, old: str, new: str) -> None:
    branch, _, name = old.rpartition(".")
    path = written(tmp_path, f"[{branch}]\n{name} = 3\n" if branch else f"[{name}]\n")
    for given in ((None, [f"{old}=3"]), (path,)):
        with pytest.raises(ConfigurationError) as caught:
            load_config(*given)
        assert str(caught.value).endswith(f"there is no '{old}'; it was renamed to {new}")
        assert "\n" not in str(caught.value)


def test_the_new_names_of_settings_exist_and_the_old_ones_do_not() -> None:
    branches = set(Config.model_fields)
    keys = {setting.key for setting in settings_of(Config())} | branches
    assert set(RENAMED_SETTINGS.values()) <= keys
    assert keys.isdisjoint(RENAMED_SETTINGS)


def test_a_renamed_setting_is_not_hinted_at_in_a_tree_without_it() -> None:
    with pytest.raises(ConfigurationError) as caught:
        load_simulation_config(None, ["evidence.persistence=0.5"])
    assert "renamed" not in str(caught.value)


def test_a_file_without_end_is_no_file_of_settings(tmp_path: Path) -> None:
    path = tmp_path / "endless.toml"
    with path.open("wb") as stream:
        stream.truncate(10**12)  # of no blocks
    with pytest.raises(ConfigurationError, match=r"endless\.toml has more than 10000000 characters"):
        load_config(path)


def test_whole_numbers_have_an_end() -> None:
    with pytest.raises(ConfigurationError, match=r"relinearize_skip=4294967296 is absurd; .* at most 2147483647"):
        load_config(overrides=["factor_graph.relinearize_skip=4294967296"])
    load_config(overrides=["factor_graph.relinearize_skip=2147483647"])


def test_noise_of_a_heading_has_an_end() -> None:
    with pytest.raises(ConfigurationError, match="tilt_sigma"):
        load_config(overrides=["odometry.tilt_sigma=1e9"])
