"""What the command line refuses: one line on standard error, exit code 2, nothing written."""

import sys
from pathlib import Path

import pytest

from tests.tools.runs import SAMPLE, Run, assert_refused, write_drive


@pytest.mark.parametrize("command", [("info",), ("replay", "-o", "out.mcap"), ("evaluate",), ("export", "--csv", "a")])
def test_input_that_is_no_log(
    dslam: Run, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, command: tuple[str, ...]
) -> None:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "text.mcap").write_text("no log, but long enough to have a signature")
    assert_refused(dslam(*command, "text.mcap"), "text.mcap", "not an MCAP")
    assert [path.name for path in tmp_path.iterdir()] == ["text.mcap"]


def test_topics_that_fit_twice(dslam: Run, tmp_path: Path) -> None:
    output = ("-o", tmp_path / "out.mcap")
    log = write_drive(tmp_path / "log.mcap", odometry=("/visual", "/wheels"))
    assert_refused(dslam("replay", log, *output), "/visual, /wheels", "--topic odometry=/visual")
    assert_refused(dslam("replay", log, *output, "--topic", "/wheels"), "KIND=/TOPIC")
    assert dslam("replay", log, *output, "--topic", "odometry=/wheels").code == 0


def test_settings(dslam: Run, tmp_path: Path) -> None:
    replay = ("replay", SAMPLE, "-o", tmp_path / "out.mcap")
    assert_refused(dslam(*replay, "--set", "keyframe.distance=2"), "did you mean keyframe.distance_m?")
    assert_refused(dslam(*replay, "--set", "loop_closure.descriptor=rings"), "rings", "descriptellation_lr")
    assert_refused(dslam(*replay, "--config", tmp_path / "none.toml"), "none.toml")
    simulate = ("simulate", tmp_path / "out.mcap")
    assert_refused(dslam(*simulate, "--set", "kidnap.gap_s=30"), "--set: kidnap.from_m is missing")
    assert_refused(dslam(*simulate, "--length", 1), "too short")
    assert_refused(dslam(*simulate, "--objects", "objects.csv"), "--trajectory")
    assert not list(tmp_path.iterdir())


def test_outputs_that_cannot_be(dslam: Run, tmp_path: Path) -> None:
    nowhere = tmp_path / "none" / "out.mcap"
    assert_refused(dslam("replay", SAMPLE, "-o", nowhere), "no folder")
    assert_refused(dslam("replay", SAMPLE, "-o", tmp_path / "a.mcap", "--save-map", nowhere), "no folder")
    assert_refused(dslam("replay", SAMPLE, "-o", tmp_path / "a.mcap", "--picture", tmp_path / "a.svg"), "end with .png")
    for folder in ("", "..", tmp_path):
        assert_refused(dslam("replay", SAMPLE, "-o", folder), "is a folder")
    assert not list(tmp_path.iterdir())


def test_output_that_is_the_input(dslam: Run, tmp_path: Path) -> None:
    """Also under another name, or as NAME.part, which is written first."""
    log = write_drive(tmp_path / "log.mcap.part")
    before = log.read_bytes()
    (tmp_path / "link.mcap").symlink_to(log)
    for output in (log, tmp_path / "link.mcap", tmp_path / "log.mcap"):
        assert_refused(dslam("replay", log, "-o", output), "is the input")
        assert_refused(dslam("export", log, "--tum", output), "is the input")
    assert log.read_bytes() == before


@pytest.mark.parametrize("second", ["a.txt", "./a.txt", "link.txt", "a.txt.part"])
def test_two_outputs_that_are_one_file(dslam: Run, tmp_path: Path, second: str) -> None:
    (tmp_path / "link.txt").symlink_to(tmp_path / "a.txt")
    names = (tmp_path / "a.txt", f"{tmp_path}/{second}")
    for first, other in (names, names[::-1]):
        assert_refused(dslam("replay", SAMPLE, "-o", first, "--save-map", other), "two outputs")
    assert not (tmp_path / "a.txt").exists()


def test_output_that_is_a_link_to_itself_is_replaced(dslam: Run, tmp_path: Path) -> None:
    loop = tmp_path / "loop.mcap"
    loop.symlink_to(loop)
    assert dslam("simulate", loop, "--length", 10).code == 0
    assert not loop.is_symlink()


def test_log_without_an_estimate(dslam: Run, mapped: Path, tmp_path: Path) -> None:
    assert_refused(dslam("evaluate", SAMPLE), "no estimate", "dslam replay")
    assert_refused(
        dslam("export", SAMPLE, "--tum", tmp_path / "out.txt"), "no poses of the estimate", "'dslam replay' finished"
    )
    assert_refused(dslam("export", SAMPLE), "--tum")
    reference = write_drive(tmp_path / "reference.mcap")
    assert_refused(dslam("evaluate", mapped, "--reference", reference), "the reference holds no truth")


@pytest.mark.parametrize(
    ("error", "code", "told"),
    [
        (ZeroDivisionError("one\nof ours"), 70, "ZeroDivisionError: one of ours"),
        (ModuleNotFoundError("No module", name="torch.nn"), 2, "pip install 'descriptellation-slam[learn]'"),
        (MemoryError(), 2, "out of memory"),
    ],
    ids=lambda value: type(value).__name__,
)
def test_errors_that_are_raised_anywhere(
    dslam: Run, monkeypatch: pytest.MonkeyPatch, error: BaseException, code: int, told: str
) -> None:
    def fail(*_: object) -> None:
        raise error

    monkeypatch.setattr("logs.summary.summarize", fail)
    assert_refused(dslam("info", SAMPLE), told, code=code)
    if code == 70:
        assert "Traceback" in dslam("info", SAMPLE, "--debug").err


@pytest.mark.parametrize(
    ("command", "module", "extra"),
    [
        ("replay {} -o map.mcap --picture map.png", "matplotlib", "pictures"),
        ("live {}", "foxglove", "live"),
        ("import map map.mcap --file town.osm", "osmium", "osm"),
    ],
)
def test_what_an_extra_is_needed_for_is_refused_before_any_work(
    dslam: Run, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, command: str, module: str, extra: str
) -> None:
    monkeypatch.chdir(tmp_path)
    monkeypatch.setitem(sys.modules, module, None)
    monkeypatch.delitem(sys.modules, "slam.display.foxglove_feed", raising=False)
    result = dslam(*command.format(SAMPLE).split())
    assert_refused(result, f"this needs {module}", f"pip install 'descriptellation-slam[{extra}]'")
    assert not list(tmp_path.iterdir())
