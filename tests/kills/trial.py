"""One command, killed at a given time and given again."""

import contextlib
import json
import os
import shutil
import signal
import time
from dataclasses import dataclass
from pathlib import Path

from logs.storage.mcap_index import MAGIC
from tests.helpers.forked_commands import ERR, OUT, start, write_files
from tests.kills.commands import Command


@dataclass(frozen=True)
class Reference:
    """What a command leaves in its folder when nothing kills it, and how long it takes."""

    files: dict[str, bytes]
    seconds: float


@dataclass(frozen=True)
class Trial:
    """Whether a command was killed before it ended, what is wrong, and how long it took when it was given again."""

    was_killed: bool
    wrong: list[str]
    seconds: float


def run_whole(command: Command, folder: Path) -> Reference:
    """Run a command that nobody kills."""
    folder.mkdir()
    code, seconds = _run(command, folder)
    if code != 0:
        raise RuntimeError(f"{command.name} ends with {code}: {(folder / ERR).read_text()[-500:]}")
    return Reference(_files(folder), seconds)


def _run(command: Command, folder: Path) -> tuple[int, float]:
    """Its exit code, and how long it takes."""
    started = time.monotonic()
    code = os.waitstatus_to_exitcode(os.waitpid(start(command.arguments, folder), 0)[1])
    return code, time.monotonic() - started


def kill_and_repeat(command: Command, folder: Path, seconds: float, reference: Reference, *, is_new: bool) -> Trial:
    """Kill a command after ``seconds``, in an empty folder if ``is_new``, or else over what a whole run left."""
    folder.mkdir()
    if not is_new:
        write_files(folder, reference.files)
    child = start(command.arguments, folder)
    time.sleep(seconds)
    os.kill(child, signal.SIGKILL)
    was_killed = os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]) == -signal.SIGKILL
    wrong = [f"after the kill: {each}" for each in _faults(command, _files(folder), reference)]
    if not is_new:
        wrong += [f"after the kill: {name} is gone" for name in reference.files if not (folder / name).exists()]
    code, again_s = _run(command, folder)
    if code != 0:
        wrong.append(f"the second run ends with {code}: {(folder / ERR).read_text()[-300:]}")
    found = _files(folder)
    wrong += [f"after the second run: {each}" for each in _faults(command, found, reference)]
    wrong += [f"the second run left no {name}" for name in reference.files if name not in found]
    shutil.rmtree(folder)
    return Trial(was_killed, wrong, again_s)


def _files(folder: Path) -> dict[str, bytes]:
    """What stands under its final name; parts and temporary files have others."""
    found = {str(path.relative_to(folder)): path for path in sorted(folder.rglob("*")) if path.is_file()}
    return {
        name: path.read_bytes()
        for name, path in found.items()
        if name not in (OUT, ERR) and not any(part.endswith((".part", ".tmp")) for part in name.split("/"))
    }


def _faults(command: Command, found: dict[str, bytes], reference: Reference) -> list[str]:
    faults = []
    for name, content in found.items():
        expected = reference.files.get(name)
        if expected is None and command.is_repeatable:
            faults.append(f"{name} is no file that a whole run leaves")
        elif command.is_repeatable and content != expected:
            faults.append(f"{name} has {len(content)} bytes, not those of a whole run")
        elif not _is_complete(name, content):
            faults.append(f"{name} is not complete")
    return faults


def _is_complete(name: str, content: bytes) -> bool:
    if name.endswith(".mcap"):
        return content.endswith(MAGIC)
    if name.endswith(".json"):
        with contextlib.suppress(ValueError):
            json.loads(content)
            return True
        return False
    return len(content) > 0
