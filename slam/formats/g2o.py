"""Pose graphs as g2o text, read and written; every file is written as ``NAME.part`` and renamed when complete."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, field
from functools import partial
from io import TextIOWrapper
from pathlib import Path
from typing import TextIO

import numpy as np
from scipy.spatial.transform import Rotation

from logs.errors import UnwritableLogError
from logs.storage.placement import put_in_place
from logs.storage.regular_file import open_regular
from slam.backend.pose_graph.pose_graph import PoseGraph, make_pose_graph
from slam.common.arrays import FloatArray
from slam.common.errors import InputDataError
from slam.common.geometry import make_transform

TRANSLATION_FIRST = np.array([3, 4, 5, 0, 1, 2])
"""Rows of a pose covariance (rotation first) in g2o's order (translation first), and the other way round."""
UNIT_TOLERANCE = 1e-3
"""A quaternion that differs from unit length by less was rounded, and is made so; another is a mistake."""
_LONGEST_LINE = 100_000
_PLANAR, _SPATIAL = ("VERTEX_SE2", "EDGE_SE2"), ("VERTEX_SE3:QUAT", "EDGE_SE3:QUAT")


@dataclass(frozen=True, slots=True, eq=False)
class G2oFile:
    """The pose graph of a file, and how many lines of each other kind were passed over."""

    graph: PoseGraph
    passed_over: dict[str, int]


def read_pose_graph(path: str | Path) -> G2oFile:
    """Read the lines VERTEX_SE2, EDGE_SE2, VERTEX_SE3:QUAT, EDGE_SE3:QUAT and FIX, either planar or spatial ones.

    The rotation part of the information is in 1/rad^2, as GTSAM reads and writes it (g2o itself takes half angles).

    Raises:
        InputDataError: the file is no such graph; names the line and what is wrong with it.
        OSError: the file cannot be read.
    """
    source = Path(path)
    parser = _Parser(str(source))
    with TextIOWrapper(open_regular(source), encoding="utf-8") as stream:
        for number, line in enumerate(_lines(source, stream), start=1):
            words = line.split()
            if words and not words[0].startswith("#"):
                parser.take(number, words)
    return parser.finish()


def _lines(source: Path, stream: TextIO) -> Iterator[str]:
    try:
        for line in iter(partial(stream.readline, _LONGEST_LINE), ""):
            if len(line) == _LONGEST_LINE:
                raise InputDataError(f"{source} has a line of {_LONGEST_LINE} characters or more; give a g2o file")
            yield line
    except UnicodeDecodeError as error:
        raise InputDataError(f"{source} is no text; give a g2o file") from error


def write_pose_graph(path: str | Path, graph: PoseGraph) -> None:
    """Write a pose graph, planar or spatial; numbers are the shortest decimals that read back to the same float64.

    Raises:
        UnwritableLogError: the file cannot be written.
    """
    write_lines(path, _planar_lines(graph) if graph.is_planar else _spatial_lines(graph))


def write_lines(path: str | Path, lines: Iterable[str]) -> None:
    """Write a text file at once: beside its name first, renamed when it is complete.

    Raises:
        UnwritableLogError: the file cannot be written.
    """
    target = Path(path)
    text = "".join(f"{line}\n" for line in lines)  # Before the file is opened: a graph that is refused leaves no file.
    part = target.with_name(target.name + ".part")
    try:
        part.write_text(text, encoding="utf-8", newline="\n")
        put_in_place(part, target)
    except OSError as error:
        raise UnwritableLogError(f"cannot write {target}: {error.strerror or error}") from error


def format_numbers(values: FloatArray) -> str:
    """Values (N,) with blanks between, the shortest decimals that read back to the same float64."""
    return " ".join(map(repr, values.tolist()))


def quaternions(poses: FloatArray) -> FloatArray:
    """(N, 4) x y z w of poses (N, 4, 4); N = 0 gives (0, 4)."""
    return Rotation.from_matrix(poses[:, :3, :3]).as_quat() if len(poses) else np.zeros((0, 4))


def _fix_lines(graph: PoseGraph) -> Iterator[str]:
    yield from (f"FIX {vertex}" for vertex in graph.fixed_ids)


def _spatial_lines(graph: PoseGraph) -> Iterator[str]:
    poses, steps = graph.T_world_vertex, graph.T_from_to
    for vertex, xyz, quaternion in zip(graph.vertex_ids, poses[:, :3, 3], quaternions(poses), strict=True):
        yield f"VERTEX_SE3:QUAT {vertex} {format_numbers(xyz)} {format_numbers(quaternion)}"
    yield from _fix_lines(graph)
    information = graph.information[:, TRANSLATION_FIRST[:, None], TRANSLATION_FIRST][:, *np.triu_indices(6)]
    rows = np.hstack([steps[:, :3, 3], quaternions(steps), information])
    yield from (f"EDGE_SE3:QUAT {a} {b} {format_numbers(row)}" for (a, b), row in zip(graph.edges, rows, strict=True))


def _planar_lines(graph: PoseGraph) -> Iterator[str]:
    for vertex, row in zip(graph.vertex_ids, _xy_yaw(graph.T_world_vertex), strict=True):
        yield f"VERTEX_SE2 {vertex} {format_numbers(row)}"
    yield from _fix_lines(graph)
    rows = np.hstack([_xy_yaw(graph.T_from_to), graph.information[:, *np.triu_indices(3)]])
    yield from (f"EDGE_SE2 {a} {b} {format_numbers(row)}" for (a, b), row in zip(graph.edges, rows, strict=True))


def _xy_yaw(poses: FloatArray) -> FloatArray:
    return np.column_stack([poses[:, 0, 2], poses[:, 1, 2], np.arctan2(poses[:, 1, 0], poses[:, 0, 0])])


@dataclass
class _Parser:
    """Takes the lines of a file one after another."""

    source: str
    kind: tuple[str, str] | None = None
    vertices: dict[int, FloatArray] = field(default_factory=dict)
    edges: list[tuple[int, int]] = field(default_factory=list)
    edge_lines: list[int] = field(default_factory=list)
    steps: list[FloatArray] = field(default_factory=list)
    information: list[FloatArray] = field(default_factory=list)
    fixed: dict[int, int] = field(default_factory=dict)
    passed_over: Counter[str] = field(default_factory=Counter)

    def take(self, number: int, words: Sequence[str]) -> None:
        where, tag = f"{self.source}, line {number}", words[0]
        if tag == "FIX":
            self.fixed.update(dict.fromkeys(_ids(where, words[1:]), number))
        elif tag in (*_PLANAR, *_SPATIAL):
            kind = _PLANAR if tag in _PLANAR else _SPATIAL
            if self.kind not in (None, kind):
                raise InputDataError(f"{where}: {tag} in a file of {self.kind[0]}; give planar or spatial poses only")
            self.kind = kind
            (self._take_vertex if tag == kind[0] else self._take_edge)(number, where, words)
        else:
            self.passed_over[tag] += 1

    def _take_vertex(self, number: int, where: str, words: Sequence[str]) -> None:
        numbers = _numbers(where, words, ids=1, count=3 if self.kind == _PLANAR else 7)
        (vertex,) = _ids(where, words[1:2])
        if vertex in self.vertices:
            raise InputDataError(f"{where}: vertex {vertex} is there already; leave one of the two lines out")
        self.vertices[vertex] = self._pose(where, numbers)

    def _take_edge(self, number: int, where: str, words: Sequence[str]) -> None:
        pose_size, size = (3, 3) if self.kind == _PLANAR else (7, 6)
        numbers = _numbers(where, words, ids=2, count=pose_size + size * (size + 1) // 2)
        start, end = _ids(where, words[1:3])
        if start == end:
            raise InputDataError(f"{where}: an edge from vertex {start} to itself; leave it out")
        self.edges.append((start, end))
        self.edge_lines.append(number)
        self.steps.append(self._pose(where, numbers[:pose_size]))
        self.information.append(_information(where, numbers[pose_size:], size))

    def _pose(self, where: str, numbers: FloatArray) -> FloatArray:
        if self.kind == _PLANAR:
            c, s = np.cos(numbers[2]), np.sin(numbers[2])
            return np.array([[c, -s, numbers[0]], [s, c, numbers[1]], [0.0, 0.0, 1.0]])
        length = float(np.linalg.norm(numbers[3:]))
        if abs(length - 1.0) > UNIT_TOLERANCE:
            raise InputDataError(f"{where}: the quaternion (x y z w) has length {length:.6g}; it must be 1")
        return make_transform(Rotation.from_quat(numbers[3:]).as_matrix(), numbers[:3])

    def finish(self) -> G2oFile:
        if self.kind is None or not self.edges:
            others = f", only {', '.join(self.passed_over)}" if self.passed_over else ""
            raise InputDataError(
                f"{self.source} holds no edge EDGE_SE2 or EDGE_SE3:QUAT{others}; give a g2o pose graph"
            )
        known = {*self.vertices, *(vertex for edge in self.edges for vertex in edge)}
        for vertex, number in self.fixed.items():
            if vertex not in known:
                raise InputDataError(f"{self.source}, line {number}: FIX of vertex {vertex}, which does not exist")
        graph = make_pose_graph(
            self.vertices,
            np.array(self.edges, dtype=np.int64),
            np.array(self.steps),
            np.array(self.information),
            np.array(list(self.fixed), dtype=np.int64),
            name_edge=lambda row: f"{self.source}, line {self.edge_lines[row]}",
        )
        return G2oFile(graph, dict(self.passed_over))


def _ids(where: str, words: Sequence[str]) -> list[int]:
    for word in words:
        if not (word.isascii() and word.isdigit() and len(word) <= 18):
            raise InputDataError(f"{where}: {word!r} is no vertex; ids are whole numbers from 0 to 10^18")
    return [int(word) for word in words]


def _numbers(where: str, words: Sequence[str], *, ids: int, count: int) -> FloatArray:
    if len(words) != 1 + ids + count:
        raise InputDataError(
            f"{where}: {words[0]} has {len(words) - 1} values; {ids} id(s) and {count} numbers must follow"
        )
    try:
        numbers = np.array([float(word) for word in words[1 + ids :]])
    except ValueError as error:
        raise InputDataError(f"{where}: {error}") from error
    if not np.isfinite(numbers).all():
        raise InputDataError(f"{where}: a number is not finite; leave the line out or mend it")
    return numbers


def _information(where: str, upper: FloatArray, size: int) -> FloatArray:
    """(K, K) in GTSAM's order, from the upper triangle row by row in g2o's."""
    information = np.zeros((size, size))
    information[np.triu_indices(size)] = upper
    information = np.triu(information) + np.triu(information, 1).T
    least = float(np.linalg.eigvalsh(information)[0])
    if least <= 1e-12 * float(np.abs(information).max()):
        raise InputDataError(
            f"{where}: the information matrix is not positive definite (least eigenvalue {least:.3g}); "
            "give what is unknown a small positive value"
        )
    return information if size == 3 else information[TRANSLATION_FIRST[:, None], TRANSLATION_FIRST]
