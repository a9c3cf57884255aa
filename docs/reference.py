"""Hooks of the site: reference pages made from the code; links to files outside docs/ become names of these files."""

import posixpath
import re
import sys
from collections.abc import Iterator, Mapping
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

ROOT = Path(__file__).resolve().parents[1]
sys.path.insert(0, str(ROOT))
_LINK = re.compile(r"(?<!!)\[(?P<text>[^]]*)\]\((?P<target>[^)#\s]+)(?:#[^)\s]*)?\)")


def on_files(files: Any, config: Any) -> Any:
    """Add the generated pages."""
    from mkdocs.structure.files import File

    for name, make in PAGES.items():
        files.append(File.generated(config, f"reference/{name}.md", content=make()))
    return files


def on_page_markdown(markdown: str, page: Any, config: Any, files: Any) -> str:
    """Leave only the text of links that leave the folder docs/: the site does not hold those files."""
    folder = posixpath.dirname(page.file.src_uri)

    def replaced(match: re.Match[str]) -> str:
        target = posixpath.normpath(posixpath.join("docs", folder, match["target"]))
        inside = target.startswith("docs/") or "://" in match["target"] or not (ROOT / target).exists()
        if inside:
            return match[0]
        name = f"`{target}`"
        return name if match["text"].strip("`") == target else f"{match['text']} ({name} in the repository)"

    return _LINK.sub(replaced, markdown)


def commands() -> str:
    """Every command with its help and options."""
    return "# Commands\n\n" + "\n".join(_sections(_root_command(), "dslam"))


def _sections(command: Any, name: str) -> Iterator[str]:
    subcommands: Mapping[str, Any] = getattr(command, "commands", {})
    if not subcommands or name != "dslam":
        yield f"## {name}\n\n{_paragraphs(command.help or '')}\n"
    rows = [_option_row(option) for option in command.params if option.name != "help"]
    if rows and not subcommands:
        yield "\n".join(["| option | | default |", "|---|---|---|", *rows, ""])
    for each, below in subcommands.items():
        yield from _sections(below, f"{name} {each}")


def _paragraphs(text: str) -> str:
    """Help as Markdown; an example is a block."""
    parts = []
    for paragraph in text.split("\n\n"):
        line = " ".join(paragraph.split())
        is_example = line.startswith("Example: ")
        parts.append(f"```\n{line.removeprefix('Example: ')}\n```" if is_example else _cell(line))
    return "\n\n".join(parts)


def _option_row(option: Any) -> str:
    flags = getattr(option, "opts", [])
    names = f"`{option.metavar or option.name}`" if not flags[0].startswith("-") else ", ".join(f"`{o}`" for o in flags)
    default = option.default
    shown = "" if default is None or default is False or callable(default) or "Sentinel" in repr(default) else default
    return f"| {names} | {_cell(getattr(option, 'help', '') or '')} | {_cell(str(shown))} |"


def _cell(text: str) -> str:
    return " ".join(text.split()).replace("|", "\\|").replace("<", "&lt;").replace("\\[", "[")


def settings() -> str:
    """Every setting with its default, what is allowed, and its meaning."""
    from slam.common.config import Config
    from slam.common.config_tree import settings_of
    from slam.simulation.config import SimulationConfig

    lines = ["# Settings", "", "`dslam config` prints them as TOML; `--set KEY=VALUE` changes one."]
    replay, simulation = list(settings_of(Config())), list(settings_of(SimulationConfig()))
    calibrated = [s for s in replay if s.key.startswith("calibration.")]
    for title, chosen in (
        ("Replay", [s for s in replay if s not in calibrated]),
        ("Calibration of a robot: estimated from the log, where it is not given", calibrated),
        ("Simulation", simulation),
    ):
        lines += ["", f"## {title}", "", "| key | default | allowed | meaning |", "|---|---|---|---|"]
        lines += [
            f"| `{s.key}` | {_cell('' if s.default is None else str(s.default))} | {_cell(s.allowed)} "
            f"| {_cell(s.meaning)} |"
            for s in chosen
        ]
    return "\n".join(lines) + "\n"


def json_keys() -> str:
    """Every key of the JSON of an evaluation."""
    from dslam import evaluate_log, replay

    with TemporaryDirectory() as folder:
        mapped = Path(folder) / "map.mcap"
        replay(ROOT / "logs" / "samples" / "short_drive.mcap", mapped)
        tree = evaluate_log(mapped).to_json_dict()
    lines = ["# JSON of an evaluation", "", "Keys of `dslam evaluate --json`, which `--require` takes, too. What is "]
    lines[-1] += "undefined is `null`. [What they mean](../evaluation.md)."
    for part, value in tree.items():
        lines += ["", f"## {part}", ""]
        lines += [f"- `{key}`" for key in _keys(value, part)] or [f"- `{part}`"]
    return "\n".join(lines) + "\n"


def _keys(value: object, prefix: str) -> Iterator[str]:
    if isinstance(value, Mapping) and value:
        for name, below in value.items():
            yield from _keys(below, f"{prefix}.{name}")
    else:
        yield prefix


def messages() -> str:
    """The schema of every message of our own, as it stands in the file, comments included."""
    source = (ROOT / "logs" / "schemas" / "dslam.proto").read_text(encoding="utf-8")
    intro = "Topics and their schemas are listed in [What goes in and what comes out](../log.md)."
    return f"# Messages\n\n{intro}\n\n```protobuf\n{source}```\n"


def _root_command() -> Any:
    from typer.main import get_command

    from tools.cli import make_app

    return get_command(make_app())


PAGES = {"commands": commands, "settings": settings, "json": json_keys, "messages": messages}
