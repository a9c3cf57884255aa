"""A fleet: logs in, one map out. Each step leaves files named by what they were made from, and is not done again."""

from __future__ import annotations

import hashlib
import json
import logging
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass
from functools import lru_cache
from importlib.metadata import version
from pathlib import Path

import numpy as np

from logs.digest import file_sha256
from logs.storage.placement import write_text
from slam.common.config import Config
from slam.common.errors import FleetError, SavedMapError
from slam.common.georeference import Georeference
from slam.fleet.changes import REPORTED, Change, LivingMap, detect_changes, write_changes
from slam.fleet.logs import FleetLog
from slam.fleet.sessions import MAP_NAME, Session, SessionTask, map_session, read_session, remove_scratch
from slam.fleet.tasks import Compute
from slam.map_joining.acceptance import MapPair, judge_pairs
from slam.map_joining.joins import Join, find_joins
from slam.map_joining.joint_map import JointMap, join_maps
from slam.map_joining.place_index import PlaceIndex, make_place_index, opened_place_index
from slam.map_joining.session_config import common_config, session_config
from slam.object_map.map_io import SavedMap, load_map, of_rows
from slam.place_recognition.imported_map import load_imported_map, make_imported_map, save_imported_map
from slam.sweeps.workers import Death

logger = logging.getLogger(__name__)

_KEY_DIGITS = 16


@dataclass(frozen=True, slots=True, eq=False)
class Fleet:
    """``logs``: digest by name, in the order given; ``sessions`` by digest; ``order``: the digests of those that were
    mapped, by date: their numbers; ``pairs`` of these; ``parts``: joint maps, ``living`` what changed in each;
    ``maps``: the file of each part, empty for a log that nothing joins.
    """

    logs: Mapping[str, str]
    sessions: Mapping[str, Session]
    order: tuple[str, ...]
    pairs: tuple[MapPair, ...]
    parts: tuple[JointMap, ...]
    living: tuple[LivingMap, ...]
    maps: tuple[str, ...]

    @property
    def changes(self) -> tuple[Change, ...]:
        """Those of the map with most sessions."""
        return self.living[0].changes if self.living else ()


@dataclass(frozen=True, slots=True)
class JoinTask:
    """Session ``number`` with the map at ``path`` is to be found in the ``index``; ``output`` takes the joins."""

    number: int
    path: Path
    index: Path
    output: Path


def map_fleet(
    logs: Sequence[FleetLog],
    folder: Path,
    config: Config,
    compute: Compute,
    *,
    georeference: Georeference | None = None,
    progress: Callable[[float, str], None] = lambda done, doing: None,
) -> Fleet:
    """Map logs by themselves, find them in one another, and join them; write the maps and what changed.

    Args:
        logs: of one city, with other ones among them.
        folder: keeps what is done; takes ``map.mcap``, further parts as ``map_2.mcap`` ..., and ``changes.geojson``.
        config: of each replay.
        compute: computes tasks, :func:`slam.fleet.tasks.compute_in_processes` for example.
        georeference: where the map of most sessions lies on earth.
        progress: called with the fraction done and what is being done.

    Raises:
        FleetError: no log could be mapped.
        LogError: a log that cannot be read, or a file that cannot be written.
    """
    digests = {log.name: log.sha256 or file_sha256(log.path) for log in logs}
    sessions, folders = _map_sessions(logs, digests, folder, config, compute, progress)
    order = _ordered(sessions)
    if not order:
        reasons = "; ".join(f"{name}: {sessions[digest].reason}" for name, digest in digests.items())
        raise FleetError(f"none of {len(logs)} logs could be mapped: {reasons}")
    maps = [load_map(folders[digest] / MAP_NAME) for digest in order]
    pairs = _find_pairs(maps, [folders[digest] for digest in order], folder, compute, progress)
    progress(0.95, "joining the maps")
    joint_config = common_config(saved.metadata for saved in maps)
    parts = join_maps(dict(enumerate(maps)), pairs, joint_config)
    stamps_ns = [sessions[digest].first_ns for digest in order]
    living = [detect_changes(part, [stamps_ns[number] for number in part.members]) for part in parts]
    names = [
        _save(folder, rank, part, alive, joint_config, georeference)
        for rank, (part, alive) in enumerate(zip(parts, living, strict=True), start=1)
    ]
    write_changes(folder / "changes.geojson", living[0].changes, georeference)
    return Fleet(digests, sessions, tuple(order), tuple(pairs), tuple(parts), tuple(living), tuple(names))


def _map_sessions(
    logs: Sequence[FleetLog],
    digests: Mapping[str, str],
    folder: Path,
    config: Config,
    compute: Compute,
    progress: Callable[[float, str], None],
) -> tuple[dict[str, Session], dict[str, Path]]:
    """The session of each digest, and its folder."""
    folders = {digest: _session_folder(folder, digest, config) for digest in digests.values()}
    sessions, tasks = dict[str, Session](), list[SessionTask]()
    for log in logs:
        digest = digests[log.name]
        done = read_session(folders[digest])
        if done is not None:
            sessions[digest] = done
        elif not log.path.exists():
            raise FleetError(
                f"{log.name} has to be mapped, and does not exist at {log.path} any more; remove it by --only"
            )
        elif all(task.sha256 != digest for task in tasks):
            tasks.append(SessionTask(log.path, digest, config, folders[digest]))
    for finished, (task, outcome) in enumerate(compute(map_session, tasks), start=1):
        if isinstance(outcome, Death):
            outcome = Session(task.sha256, "the process that mapped it died each time, perhaps for lack of memory")
        sessions[task.sha256] = outcome
        told = f"{len(outcome.notes)} warnings" if outcome.is_mapped else f"not mapped: {outcome.reason}"
        progress(0.8 * finished / len(tasks), f"{finished}/{len(tasks)} {task.path.name}: {told}")
    for each in folders.values():
        remove_scratch(each)
    return sessions, folders


def session_maps(fleet: Fleet, folder: Path, config: Config) -> list[Path]:
    """The condensed maps of the sessions of a fleet in a folder, by their numbers."""
    return [_session_folder(folder, digest, config) / MAP_NAME for digest in fleet.order]


def _session_folder(folder: Path, digest: str, config: Config) -> Path:
    return folder / "sessions" / _key(digest, config.model_dump_json(), version("descriptellation-slam"))


def _ordered(sessions: Mapping[str, Session]) -> list[str]:
    """Digests of the sessions that were mapped, by date."""
    mapped = [session for session in sessions.values() if session.is_mapped]
    return [each.sha256 for each in sorted(mapped, key=lambda session: (session.first_ns, session.sha256))]


def _find_pairs(
    maps: Sequence[SavedMap],
    folders: Sequence[Path],
    folder: Path,
    compute: Compute,
    progress: Callable[[float, str], None],
) -> list[MapPair]:
    """The verdicts on all pairs of sessions. Each session is searched for in those before it, once."""
    config = common_config(saved.metadata for saved in maps)
    names = [each.name for each in folders]
    index_path = folder / "joins" / f"index_{_key(*names)}.mcap"
    index_path.parent.mkdir(parents=True, exist_ok=True)
    tasks = [
        JoinTask(number, path / MAP_NAME, index_path, index_path.with_name(f"{_key(*names[: number + 1])}.json"))
        for number, path in enumerate(folders)
    ]
    waiting = [task for task in tasks if not task.output.exists()]
    if waiting and not index_path.exists():
        for outdated in index_path.parent.glob("index_*.mcap"):
            outdated.unlink()
        index = make_place_index(maps, sigma_m=config.calibration.objects.landmark_sigma_m)
        save_imported_map(index_path, index.objects)
    for finished, (task, outcome) in enumerate(compute(join_session, waiting), start=1):
        if isinstance(outcome, Death):
            raise FleetError(f"the process that searches for the places of {task.path} died; give it more memory")
        progress(0.8 + 0.15 * finished / len(waiting), f"found the places of {finished} of {len(waiting)} sessions")
    return judge_pairs(maps, [join for task in tasks for join in _read_joins(task)], config)


def join_session(task: JoinTask) -> int:
    """Find the places of a session in the index; returns how many joins were written."""
    saved = load_map(task.path)
    joins = find_joins(saved, task.number, _opened(task.index), session_config(saved.metadata))
    write_text(task.output, json.dumps([asdict(join) for join in joins], default=np.ndarray.tolist))
    return len(joins)


@lru_cache(maxsize=1)
def _opened(path: Path) -> PlaceIndex:
    """Once a process."""
    return opened_place_index(load_imported_map(path))


def _read_joins(task: JoinTask) -> list[Join]:
    return [
        Join(
            **{
                **values,
                "T_reference_place": np.array(values["T_reference_place"]),
                "covariance": np.array(values["covariance"]),
                "pairs": tuple((own, other) for own, other in values["pairs"]),
            }
        )
        for values in json.loads(task.output.read_text(encoding="utf-8"))
    ]


def _save(
    folder: Path,
    rank: int,
    part: JointMap,
    living: LivingMap,
    config: Config,
    georeference: Georeference | None,
) -> str:
    """Write the landmarks of a part that a session would see now as a map of tiles; returns its name, empty if none."""
    if rank > 1 and len(part.members) == 1:
        return ""
    is_present = living.presence.useful >= REPORTED
    now = of_rows(part.objects, is_present)
    name = "map.mcap" if rank == 1 else f"map_{rank}.mcap"
    try:
        tiles = make_imported_map(
            now.positions,
            now.labels,
            now.ids,
            sigma_m=config.calibration.objects.landmark_sigma_m,
            georeference=georeference if rank == 1 else None,
            source={"source": f"a fleet of {len(part.members)} sessions", "version": version("descriptellation-slam")},
        )
    except SavedMapError as error:
        logger.warning("%s is not written: %s", name, error)
        return ""
    save_imported_map(folder / name, tiles, now)
    return name


def _key(*parts: str) -> str:
    return hashlib.sha256(json.dumps(parts).encode()).hexdigest()[:_KEY_DIGITS]
