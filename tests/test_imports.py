"""The import rules of the packages, read from the source."""

import ast
from collections.abc import Iterator
from functools import cache
from pathlib import Path

import pytest

from tests.tools.runs import ROOT, loaded_by, text_of

OURS = ("descriptors", "logs", "slam", "tools")


def sources(*folders: str) -> list[Path]:
    return [path for folder in folders for path in sorted((ROOT / folder).rglob("*.py")) if "_pb2" not in path.name]


@cache
def nodes_of(path: Path) -> tuple[ast.AST, ...]:
    """All nodes of a file."""
    return tuple(ast.walk(ast.parse(text_of(path))))


@cache
def imports(path: Path) -> tuple[str, ...]:
    """Full names of all modules that a file imports, wherever in it."""
    return tuple(_imports(path))


def _imports(path: Path) -> Iterator[str]:
    package = path.relative_to(ROOT).parent.parts
    for node in nodes_of(path):
        if isinstance(node, ast.Import):
            yield from (name.name for name in node.names)
        elif isinstance(node, ast.ImportFrom):
            base = ".".join(package[: len(package) - node.level + 1]) + "." if node.level else ""
            module = f"{base}{node.module or ''}".strip(".")
            yield module
            yield from (f"{module}.{name.name}" for name in node.names)


def importers_of(module: str, *folders: str) -> set[str]:
    return {
        path.relative_to(ROOT).as_posix()
        for path in sources(*folders)
        if any(name == module or name.startswith(f"{module}.") for name in imports(path))
    }


@pytest.mark.parametrize(
    ("package", "forbidden"),
    [(low, high) for low in ("descriptors", "logs") for high in OURS if low != high] + [("slam", "tools")],
)
def test_arrows_point_down(package: str, forbidden: str) -> None:
    assert importers_of(forbidden, package) == set()


def test_packages_do_not_import_tests() -> None:
    assert importers_of("tests", *OURS) == set()


def test_only_files_and_the_writer_import_mcap() -> None:
    files = {f"logs/storage/{name}.py" for name in ("arrays", "mcap_file", "mcap_index")}
    assert importers_of("mcap", *OURS) == files | {"logs/writer.py"}


def test_only_the_back_end_imports_gtsam() -> None:
    assert all(name.startswith("slam/backend/") for name in importers_of("gtsam", *OURS))


LAYERS = (
    {"common"},
    {"backend", "odometry"},
    {"object_map"},
    {"registration"},
    {"frontend", "place_recognition", "formats"},
    {"self_calibration"},
    {"localization"},
    {"loop_closure"},
    {"display", "scan_localization", "trajectory_check"},
    {"final_map", "assessment", "graph_condenser"},
    {"system", "prepared_log"},
    {"provenance"},
    {"live_slam"},
    {"log_mapper"},
    {"live_drive", "replay"},
    {"simulation", "evaluation"},
    {"sweeps", "library"},
    {"fleet"},
)
"""The stages of the method: each imports only from the rows above its own."""


def test_every_stage_has_a_layer() -> None:
    stages = {path.name for path in (ROOT / "slam").iterdir() if path.is_dir() and path.name != "__pycache__"}
    files = {path.stem for path in (ROOT / "slam").glob("*.py")} - {"__init__"}
    assert stages | files == set().union(*LAYERS)


@pytest.mark.parametrize("row", range(len(LAYERS)))
def test_stages_import_only_from_the_layers_before(row: int) -> None:
    allowed = set().union(*LAYERS[:row])
    for stage in sorted(LAYERS[row]):
        folder = ROOT / "slam" / stage
        for path in sources(f"slam/{stage}") if folder.is_dir() else [folder.with_suffix(".py")]:
            used = {name.split(".")[1] for name in imports(path) if name.startswith("slam.")}
            assert used <= allowed | {stage}, path


def test_nothing_imports_the_lab() -> None:
    assert {path for path in importers_of("tools.lab", *OURS) if not path.startswith("tools/lab/")} == set()


def test_no_folder_holds_more_files_than_a_reader_takes_in() -> None:
    for package in OURS:
        for folder in {path.parent for path in sources(package)}:
            assert len(list(folder.glob("*.py"))) <= 15, folder


def test_no_class_is_longer_than_a_reader_takes_in() -> None:
    for package in OURS:
        for path in sources(package):
            for node in nodes_of(path):
                if isinstance(node, ast.ClassDef) and node.end_lineno is not None:
                    assert node.end_lineno - node.lineno < 250, f"{path}: {node.name}"


def test_metrics_neither_read_files_nor_plot() -> None:
    assert not importers_of("matplotlib", "slam/evaluation")
    assert importers_of("logs.reader", "slam/evaluation") == {"slam/evaluation/inputs/records.py"}


def test_distributions_come_from_special_functions() -> None:
    """Loading scipy.stats takes a third of a second at each start."""
    assert importers_of("scipy.stats", *OURS) == set()


def test_libraries_print_nothing_and_do_not_exit() -> None:
    for path in sources("descriptors", "logs", "slam"):
        calls = {n.func.id for n in nodes_of(path) if isinstance(n, ast.Call) and isinstance(n.func, ast.Name)}
        assert calls.isdisjoint({"print", "exit", "quit"}), path


def test_descriptors_alone_import_torch() -> None:
    """Those that need none are tested in tests/descriptors/test_registry.py."""
    assert importers_of("torch", "slam", "tools", "logs") == set()


@pytest.mark.parametrize(
    ("started", "heavy"),
    [
        (
            "from typer.main import get_command; from tools.cli import make_app; get_command(make_app())",
            "numpy scipy gtsam torch matplotlib pydantic mcap google.protobuf rich.progress",
        ),
        (
            "from tools.cli import run; run(['info', 'logs/samples/short_drive.mcap'])",
            "torch matplotlib scipy gtsam rosbags numpy.ma slam tools.lab",
        ),
    ],
    ids=["command line", "info"],
)
def test_what_is_started_loads_only_what_it_needs(started: str, heavy: str) -> None:
    assert loaded_by(started, heavy) == ""
