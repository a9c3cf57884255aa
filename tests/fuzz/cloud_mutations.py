"""Mutated clouds: PLY files of altered fields."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from tests.fuzz.byte_mutations import FLOATS, INTEGERS, TEXTS, mutate_bytes, mutate_text
from tests.logs.clouds.clouds import post

Columns = dict[str, NDArray[Any]]

_PLACES = ((3.0, 4.0), (-5.0, 2.0), (6.0, -3.0), (-4.0, -6.0), (9.0, 1.0), (0.0, 7.0))
_PLY_TYPES = {"i1": "char", "u1": "uchar", "i2": "short", "u2": "ushort", "i4": "int", "u4": "uint", "f4": "float",
              "f8": "double"}  # fmt: skip
_KINDS = (*_PLY_TYPES, "i8", "u8")


def make_columns() -> Columns:
    """Six posts, each an instance of one of two classes."""
    posts = [post(x, y, height_m=1.0) for x, y in _PLACES]
    numbers = np.repeat(np.arange(len(posts)), [len(points) for points in posts])
    x, y, z = np.concatenate(posts).astype("f4").T
    return {"x": x, "y": y, "z": z, "class": (80 + numbers % 2).astype("u4"), "label": (numbers + 1).astype("u4")}


def mutate_ply(rng: np.random.Generator) -> bytes:
    """A PLY file, in either order of bytes, with a few changes."""
    columns = _mutate_columns(make_columns(), rng)
    storage = str(rng.choice(["binary_little_endian", "binary_big_endian"]))
    order = ">" if storage == "binary_big_endian" else "<"
    columns = {name: values if values.dtype.str[1:] in _PLY_TYPES else values.astype("f8")
               for name, values in columns.items()}  # fmt: skip
    lines = ["ply", f"format {storage} 1.0", "comment fuzz", f"element vertex {_count(columns)}"]
    lines += [f"property {_PLY_TYPES[values.dtype.str[1:]]} {name}" for name, values in columns.items()]
    return _damaged([*lines, "end_header"], _rows(columns, order), rng)


def _mutate_columns(columns: Columns, rng: np.random.Generator) -> Columns:
    """A few changes of values, types, names and numbers of the fields."""
    for _ in range(int(rng.choice([0, 1, 1, 2, 4]))):
        names = list(columns)
        if not names:
            break
        name = str(rng.choice(names))
        values = columns[name].copy()
        match int(rng.integers(7)):
            case 0:
                values[rng.integers(len(values), size=20) if len(values) else []] = _odd(values.dtype, rng)
            case 1:
                values[:] = _odd(values.dtype, rng)
            case 2:
                with np.errstate(over="ignore", invalid="ignore"):
                    values = values.astype(str(rng.choice(_KINDS)))
            case 3:
                odd = str(rng.choice(["scalar_" + name, "class", "label", "_", "x", "intensity", *TEXTS[:8]]))
                columns = {odd if each == name else each: of for each, of in columns.items()}
                continue
            case 4:
                del columns[name]
                continue
            case 5:
                length = int(rng.choice([0, 1, 10]))
                columns = {each: of[:length] for each, of in columns.items()}
                continue
            case _:
                values = values * values.dtype.type(rng.choice([0, 1000, -1])) if values.dtype.kind == "f" else values
        columns[name] = values
    return columns


def _odd(kind: np.dtype[Any], rng: np.random.Generator) -> Any:
    if kind.kind == "f":
        with np.errstate(over="ignore"):
            return np.float64(rng.choice(FLOATS)).astype(kind)
    return np.uint64(int(rng.choice(np.array(INTEGERS, dtype=object))) % 2**64).astype(kind)


def _count(columns: Columns) -> int:
    return len(next(iter(columns.values()))) if columns else 0


def _rows(columns: Columns, order: str) -> bytes:
    kinds = [(str(i), values.dtype.newbyteorder(order)) for i, values in enumerate(columns.values())]
    rows = np.zeros(_count(columns), dtype=kinds)
    for i, values in enumerate(columns.values()):
        rows[str(i)] = values
    return rows.tobytes()


def _damaged(header: list[str], body: bytes, rng: np.random.Generator) -> bytes:
    """Sometimes with another header than belongs to ``body``, sometimes with bytes altered anywhere."""
    head = ("\n".join(header) + "\n").encode(errors="surrogatepass")
    if rng.random() < 0.3:
        head = mutate_text(head, rng)
    return mutate_bytes(head + body, rng) if rng.random() < 0.2 else head + body
