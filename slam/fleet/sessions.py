"""One log, mapped by itself: the first task of a fleet, a function of the log and the settings."""

from __future__ import annotations

import json
import shutil
import tempfile
from dataclasses import asdict, dataclass
from pathlib import Path

from logs.container.json_text import parse_json
from logs.errors import LogError
from logs.storage.placement import write_text
from slam.common.config import Config
from slam.common.errors import SlamError
from slam.map_joining.condensed_map import condense_map, stretch_length_m
from slam.map_joining.session_config import session_config
from slam.object_map.map_io import load_map, write_map
from slam.object_map.map_summary import summarize_map
from slam.replay import replay

MAP_NAME, LEDGER_NAME, SCRATCH = "map.mcap", "session.json", "mapping-"


@dataclass(frozen=True, slots=True)
class SessionTask:
    """A log at ``path`` that is to be mapped with ``config`` into the folder ``folder``."""

    path: Path
    sha256: str
    config: Config
    folder: Path


@dataclass(frozen=True, slots=True)
class Session:
    """The result of mapping a log. ``reason``: why it has no map; ``first_ns``, ``last_ns``: stamps of its keyframes;
    ``notes``: what a replay would warn of. Nothing in it depends on when or where it was mapped.
    """

    sha256: str
    reason: str
    keyframes: int = 0
    landmarks: int = 0
    travel_m: float = 0.0
    first_ns: int = 0
    last_ns: int = 0
    notes: tuple[str, ...] = ()

    @property
    def is_mapped(self) -> bool:
        """Whether there is a map."""
        return not self.reason


def map_session(task: SessionTask) -> Session:
    """Map a log into ``folder``: its condensed map and its ledger, which is written last."""
    task.folder.mkdir(parents=True, exist_ok=True)
    scratch = Path(tempfile.mkdtemp(prefix=SCRATCH, dir=task.folder))
    try:
        session = _mapped(task, scratch)
    except (LogError, SlamError) as error:
        # The name of the scratch folder is another each time.
        reason = " ".join([str(error), *getattr(error, "__notes__", ())]).replace(f"{scratch}/", "")
        session = Session(task.sha256, reason)
    finally:
        shutil.rmtree(scratch, ignore_errors=True)
    write_text(task.folder / LEDGER_NAME, json.dumps(asdict(session), indent=1) + "\n")
    return session


def remove_scratch(folder: Path) -> None:
    """Remove what a process that was killed left in the folder of its session."""
    for scratch in folder.glob(f"{SCRATCH}*"):
        shutil.rmtree(scratch, ignore_errors=True)


def read_session(folder: Path) -> Session | None:
    """What a finished task left in its folder; None if there is nothing, or nothing that can be used."""
    try:
        values = parse_json((folder / LEDGER_NAME).read_text(encoding="utf-8"))
        session = Session(**{**values, "notes": tuple(values["notes"])})
    except (OSError, ValueError, TypeError, KeyError):
        return None
    return session if session.reason or (folder / MAP_NAME).exists() else None


def _mapped(task: SessionTask, scratch: Path) -> Session:
    whole = scratch / MAP_NAME
    summary = replay(task.path, scratch / "replay.mcap", task.config, map_path=whole)
    saved = load_map(whole)
    config = session_config(saved.metadata)
    write_map(task.folder / MAP_NAME, condense_map(saved, stretch_m=stretch_length_m(config)))
    stamps_ns = saved.graph.keyframe_stamps_ns
    return Session(
        sha256=task.sha256,
        reason="",
        keyframes=len(saved.graph.keyframe_ids),
        landmarks=len(saved.objects.ids),
        travel_m=round(summarize_map(saved)["path_m"], 3),
        first_ns=int(stamps_ns.min()),
        last_ns=int(stamps_ns.max()),
        notes=summary.notes,
    )
