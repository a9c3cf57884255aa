"""Pose graphs as g2o text, read and written.

GTSAM's own reader takes numbers that are not finite, quaternions of any length and indefinite information for good, and
names no line; so the lines are checked here.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import partial
from io import TextIOWrapper
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

from logs.storage.placement import write_text
from logs.storage.regular_file import open_regular
from slam.backend.pose_graph.pose_graph import PoseGraph, make_pose_graph
from slam.common.arrays import FloatArray
from slam.common.errors import InputDataError
from slam.common.geometry import make_transform

TRANSLATION_FIRST = np.array([3, 4, 5, 0, 1, 2])
"""Rows of a pose covariance (rotation first) in g2o's order (translation first), and the other way round."""
UNIT_TOLERANCE = 1e-3
"""A quaternion that differs from unit length by less was rounded, and is made so; another is a mistake."""
_MAX_LINE_LENGTH = 100_000
_FIX = "FIX"
_SIZES = {"VERTEX_SE2": (1, 3), "EDGE_SE2": (2, 9), "VERTEX_SE3:QUAT": (1, 7), "EDGE_SE3:QUAT": (2, 28)}
"""How many ids and numbers follow each tag."""


@dataclass(frozen=True, slots=True, eq=False)
class G2oFile:
    """The pose graph of a file, and how many lines of each other kind were ignored."""

    graph: PoseGraph
    passed_over: dict[str, int]


@dataclass(frozen=True, slots=True)
class _Line:
    """A line of the file: where it stands, its ids, and the numbers (N,) after them."""

    where: str
    ids: tuple[int, ...]
    numbers: FloatArray


def read_pose_graph(path: str | Path) -> G2oFile:
    """Read the lines VERTEX_SE2, EDGE_SE2, VERTEX_SE3:QUAT, EDGE_SE3:QUAT and FIX, either planar or spatial ones.

    The rotation part of the information is in 1/rad^2, as GTSAM reads and writes it (g2o itself takes half angles).

    Raises:
        InputDataError: the file is no such graph; names the line and what is wrong with it.
        OSError: the file cannot be read.
    """
    lines: dict[str, list[_Line]] = {tag: [] for tag in (*_SIZES, _FIX)}
    passed_over: Counter[str] = Counter()
    for where, words in _read_words(Path(path)):
        if words[0] in lines:
            lines[words[0]].append(_parse(where, words))
        else:
            passed_over[words[0]] += 1
    vertices, edges = _choose_dimension(str(path), lines, passed_over)
    poses: dict[int, FloatArray] = {}
    for line in vertices:
        if line.ids[0] in poses:
            raise InputDataError(f"{line.where}: vertex {line.ids[0]} is defined twice; remove one of the two lines")
        poses[line.ids[0]] = _pose(line.where, line.numbers)
    size = 3 if len(edges[0].numbers) == 9 else 7
    known = {*poses, *(vertex for line in edges for vertex in line.ids)}
    fixed = {vertex: line.where for line in lines[_FIX] for vertex in line.ids}
    for vertex, where in fixed.items():
        if vertex not in known:
            raise InputDataError(f"{where}: FIX of vertex {vertex}, which does not exist")
    graph = make_pose_graph(
        poses,
        np.array([line.ids for line in edges], dtype=np.int64),
        np.array([_pose(line.where, line.numbers[:size]) for line in edges]),
        np.array([_information(line.where, line.numbers[size:]) for line in edges]),
        np.array(list(fixed), dtype=np.int64),
        name_edge=lambda row: edges[row].where,
    )
    return G2oFile(graph, dict(passed_over))


def _read_words(source: Path) -> Iterator[tuple[str, list[str]]]:
    """Where each line stands and its words, without comments and empty lines."""
    with TextIOWrapper(open_regular(source), encoding="utf-8") as stream:
        try:
            for number, line in enumerate(iter(partial(stream.readline, _MAX_LINE_LENGTH), ""), start=1):
                if len(line) == _MAX_LINE_LENGTH:
                    raise InputDataError(f"{source} has a line of {len(line)} characters or more; give a g2o file")
                words = line.split()
                if words and not words[0].startswith("#"):
                    yield f"{source}, line {number}", words
        except UnicodeDecodeError as error:
            raise InputDataError(f"{source} is not text; give a g2o file") from error


def _parse(where: str, words: Sequence[str]) -> _Line:
    tag = words[0]
    id_count, count = _SIZES.get(tag, (len(words) - 1, 0))
    if len(words) != 1 + id_count + count:
        raise InputDataError(
            f"{where}: {tag} has {len(words) - 1} values; {id_count} id(s) and {count} numbers must follow"
        )
    for word in words[1 : 1 + id_count]:
        if not (word.isascii() and word.isdigit() and len(word) <= 18):
            raise InputDataError(f"{where}: {word!r} is not a vertex; ids are whole numbers from 0 to 10^18")
    ids = tuple(map(int, words[1 : 1 + id_count]))
    if tag.startswith("EDGE") and ids[0] == ids[1]:
        raise InputDataError(f"{where}: an edge from vertex {ids[0]} to itself; remove it")
    try:
        numbers = np.array([float(word) for word in words[1 + id_count :]])
    except ValueError as error:
        raise InputDataError(f"{where}: {error}") from error
    if not np.isfinite(numbers).all():
        raise InputDataError(f"{where}: a number is not finite; remove or correct the line")
    return _Line(where, ids, numbers)


def _choose_dimension(
    source: str, lines: dict[str, list[_Line]], others: Counter[str]
) -> tuple[list[_Line], list[_Line]]:
    """Vertices and edges of the file, which must all be planar or all spatial."""
    planar, spatial = ([lines[f"VERTEX_{kind}"], lines[f"EDGE_{kind}"]] for kind in ("SE2", "SE3:QUAT"))
    if any(planar) and any(spatial):
        where = (spatial[0] or spatial[1])[0].where
        raise InputDataError(f"{where}: spatial poses in a file of planar ones; give planar or spatial poses only")
    vertices, edges = planar if any(planar) else spatial
    if not edges:
        listed = f", only {', '.join(others)}" if others else ""
        raise InputDataError(f"{source} holds no edge EDGE_SE2 or EDGE_SE3:QUAT{listed}; give a g2o pose graph")
    return vertices, edges


def _pose(where: str, numbers: FloatArray) -> FloatArray:
    """(3, 3) from x, y, yaw, or (4, 4) from x, y, z and a quaternion x, y, z, w."""
    if len(numbers) == 3:
        c, s = np.cos(numbers[2]), np.sin(numbers[2])
        return np.array([[c, -s, numbers[0]], [s, c, numbers[1]], [0.0, 0.0, 1.0]])
    length = float(np.linalg.norm(numbers[3:]))
    if abs(length - 1.0) > UNIT_TOLERANCE:
        raise InputDataError(f"{where}: the quaternion (x y z w) has length {length:.6g}; it must be 1")
    return make_transform(Rotation.from_quat(numbers[3:]).as_matrix(), numbers[:3])


def _information(where: str, upper: FloatArray) -> FloatArray:
    """(K, K) in GTSAM's order, from the upper triangle row by row in g2o's."""
    size = 3 if len(upper) == 6 else 6
    information = np.zeros((size, size))
    information[np.triu_indices(size)] = upper
    information += np.triu(information, 1).T
    least = float(np.linalg.eigvalsh(information)[0])
    if least <= 1e-12 * float(np.abs(information).max()):
        raise InputDataError(
            f"{where}: the information matrix is not positive definite (least eigenvalue {least:.3g}); "
            "give unknown directions a small positive value"
        )
    return information if size == 3 else information[TRANSLATION_FIRST[:, None], TRANSLATION_FIRST]


def write_pose_graph(path: str | Path, graph: PoseGraph) -> None:
    """Write a pose graph, planar or spatial; numbers are the shortest decimals that read back to the same float64.

    Raises:
        UnwritableLogError: the file cannot be written.
    """
    write_text(path, "".join(f"{line}\n" for line in graph_lines(graph)))


def graph_lines(graph: PoseGraph) -> Iterator[str]:
    """The lines of :func:`write_pose_graph`."""
    kind, pose_rows, size = ("SE2", _xy_yaw, 3) if graph.is_planar else ("SE3:QUAT", position_and_quaternion, 6)
    for vertex, row in zip(graph.vertex_ids, pose_rows(graph.T_world_vertex), strict=True):
        yield f"VERTEX_{kind} {vertex} {format_numbers(row)}"
    yield from (f"{_FIX} {vertex}" for vertex in graph.fixed_ids)
    order = np.arange(3) if graph.is_planar else TRANSLATION_FIRST
    information = graph.information[:, order[:, None], order][:, *np.triu_indices(size)]
    rows = np.hstack([pose_rows(graph.T_from_to), information])
    yield from (f"EDGE_{kind} {a} {b} {format_numbers(row)}" for (a, b), row in zip(graph.edges, rows, strict=True))


def format_numbers(values: FloatArray) -> str:
    """Values (N,) with blanks between, the shortest decimals that read back to the same float64."""
    return " ".join(map(repr, values.tolist()))


def quaternions(poses: FloatArray) -> FloatArray:
    """(N, 4) x y z w of poses (N, 4, 4); N = 0 gives (0, 4)."""
    return Rotation.from_matrix(poses[:, :3, :3]).as_quat() if len(poses) else np.zeros((0, 4))


def position_and_quaternion(poses: FloatArray) -> FloatArray:
    """(N, 7) x y z and quaternion x y z w of poses (N, 4, 4)."""
    return np.hstack([poses[:, :3, 3], quaternions(poses)])


def _xy_yaw(poses: FloatArray) -> FloatArray:
    return np.column_stack([poses[:, 0, 2], poses[:, 1, 2], np.arctan2(poses[:, 1, 0], poses[:, 0, 0])])
