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
from slam.map_joining.condensed_map import stretch_length_m
from slam.map_joining.joins import Join, find_joins
from slam.map_joining.joint_map import join_parts
from slam.map_joining.part import Part, are_saved, fold_part, load_parts, save_parts, saved_parts, session_part
from slam.map_joining.place_index import PlaceIndex, make_place_index, opened_place_index
from slam.map_joining.session_config import common_config, session_config
from slam.object_map.map_io import SavedMap, load_map, of_rows
from slam.place_recognition.imported_map import load_imported_map, make_imported_map, save_imported_map
from slam.sweeps.workers import Death

logger = logging.getLogger(__name__)

BLOCK = 16
"""Sessions that are folded together, by date; as many of the latest sessions are not, at least."""


@dataclass(frozen=True, slots=True, eq=False)
class Fleet:
    """``logs``: digest by name, in the order given; ``sessions`` by digest; ``order``: the digests of those that were
    mapped, by date: their numbers; ``blocks``: the sessions of each map that was joined last, of one or of many that
    were folded, and ``pairs`` of these maps; ``parts`` of the result, ``living`` what changed in each; ``maps``: the
    file of each part, empty for a log that nothing joins.
    """

    logs: Mapping[str, str]
    sessions: Mapping[str, Session]
    order: tuple[str, ...]
    blocks: tuple[tuple[int, ...], ...]
    pairs: tuple[MapPair, ...]
    parts: tuple[Part, ...]
    living: tuple[LivingMap, ...]
    maps: tuple[str, ...]

    @property
    def changes(self) -> tuple[Change, ...]:
        """Those of the map with most sessions."""
        return self.living[0].changes if self.living else ()


@dataclass(frozen=True, slots=True)
class JoinTask:
    """Map ``number``, at ``path``, is to be found in the ``index``; ``output`` takes the joins."""

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
    joiner = _Joiner([folders[digest] / MAP_NAME for digest in order], folder, compute, progress)
    count = max(len(order) // BLOCK - 1, 0) * BLOCK
    joined = joiner.join(count, joiner.fold(count), len(order))
    parts, joint_config = joined.parts, joined.config
    stamps_ns = [sessions[digest].first_ns for digest in order]
    living = [detect_changes(part, [stamps_ns[number] for number in part.sessions]) for part in parts]
    names = [
        _save(folder, rank, part, alive, joint_config, georeference)
        for rank, (part, alive) in enumerate(zip(parts, living, strict=True), start=1)
    ]
    write_changes(folder / "changes.geojson", living[0].changes, georeference)
    return Fleet(
        digests, sessions, tuple(order), joined.blocks, joined.pairs, tuple(parts), tuple(living), tuple(names)
    )


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
                f"{log.name} has to be mapped, and does not exist at {log.path} any more; remove it with --only"
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


@dataclass(frozen=True, slots=True, eq=False)
class _Joined:
    """``parts`` of the maps of ``blocks``, which ``pairs`` relate; ``config``: by which they were compared."""

    blocks: tuple[tuple[int, ...], ...]
    pairs: tuple[MapPair, ...]
    parts: list[Part]
    config: Config


@dataclass(frozen=True, slots=True, eq=False)
class _Joiner:
    """Joins the sessions whose maps are at ``paths``, by date; ``folder`` keeps what is done."""

    paths: Sequence[Path]
    folder: Path
    compute: Compute
    progress: Callable[[float, str], None]

    def fold(self, count: int) -> list[Path]:
        """Join and fold the first ``count`` sessions, block by block; returns the files of the parts."""
        names = [path.parent.name for path in self.paths]
        kept: list[Path] = []
        for end in range(BLOCK, count + 1, BLOCK):
            folder = self.folder / "folded" / _key(*names[:end])
            if not are_saved(folder):
                joined = self.join(end - BLOCK, kept, end)
                stretch_m = stretch_length_m(joined.config)
                save_parts(folder, [fold_part(part, stretch_m=stretch_m) for part in joined.parts])
            kept = saved_parts(folder)
        return kept

    def join(self, first: int, kept: Sequence[Path], end: int) -> _Joined:
        """The sessions from ``first`` to ``end`` and, in the files ``kept``, those before them."""
        parts = load_parts(kept[0].parent) if kept else []
        parts += [session_part(number, load_map(self.paths[number])) for number in range(first, end)]
        config = common_config(part.saved.metadata for part in parts)
        pairs = self._find_pairs([part.saved for part in parts], [*kept, *self.paths[first:end]], len(kept), config)
        self.progress(0.95, "joining the maps")
        blocks = tuple(part.sessions for part in parts)
        return _Joined(blocks, tuple(pairs), join_parts(parts, pairs, config), config)

    def _find_pairs(self, maps: Sequence[SavedMap], paths: Sequence[Path], known: int, config: Config) -> list[MapPair]:
        """The verdicts on all pairs of maps. Each but the first ``known`` ones is searched for in those before it."""
        names = [f"{path.parent.name}/{path.name}" for path in paths]
        index_path = self.folder / "joins" / f"index_{_key(*names)}.mcap"
        index_path.parent.mkdir(parents=True, exist_ok=True)
        tasks = [
            JoinTask(number, path, index_path, index_path.with_name(f"{_key(*names[: number + 1])}.json"))
            for number, path in enumerate(paths)
        ][known:]
        waiting = [task for task in tasks if not task.output.exists()]
        if waiting and not index_path.exists():
            for outdated in index_path.parent.glob("index_*.mcap"):
                outdated.unlink()
            index = make_place_index(maps, sigma_m=config.calibration.objects.landmark_sigma_m)
            save_imported_map(index_path, index.objects)
        for finished, (task, outcome) in enumerate(self.compute(join_session, waiting), start=1):
            if isinstance(outcome, Death):
                raise FleetError(f"the process that searches for the places of {task.path} died; give it more memory")
            self.progress(0.8 + 0.15 * finished / len(waiting), f"places of {finished} of {len(waiting)} maps found")
        return judge_pairs(maps, [join for task in tasks for join in _read_joins(task)], config)


def join_session(task: JoinTask) -> int:
    """Find the places of a map in the index; returns how many joins were written."""
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
    part: Part,
    living: LivingMap,
    config: Config,
    georeference: Georeference | None,
) -> str:
    """Write the landmarks of a part that a session would see now as a map of tiles; returns its name, empty if none."""
    if rank > 1 and len(part.sessions) == 1:
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
            source={"source": f"a fleet of {len(part.sessions)} sessions", "version": version("descriptellation-slam")},
        )
    except SavedMapError as error:
        logger.warning("%s is not written: %s", name, error)
        return ""
    save_imported_map(folder / name, tiles, now)
    return name


def _key(*parts: str) -> str:
    # 64 bits tell any number of logs apart.
    return hashlib.sha256(json.dumps(parts).encode()).hexdigest()[:16]
