"""Mutated clouds: PLY files of an altered header, or of altered values."""

from __future__ import annotations

import numpy as np

from tests.fuzz.byte_mutations import mutate_bytes, mutate_text
from tests.logs.clouds.clouds import post

_PLACES = ((3.0, 4.0), (-5.0, 2.0), (6.0, -3.0), (-4.0, -6.0), (9.0, 1.0), (0.0, 7.0))
_HEADER = """ply
format {} 1.0
comment fuzz
element vertex {}
property double x
property double y
property double z
property uint class
property uint label
end_header
"""


def mutate_ply(rng: np.random.Generator) -> bytes:
    """Six posts, each an instance of one of two classes, in either order of bytes, with a few changes."""
    storage, order = (("binary_little_endian", "<"), ("binary_big_endian", ">"))[int(rng.integers(2))]
    posts = [post(x, y, height_m=1.0) for x, y in _PLACES]
    kind = [("at", f"{order}f8", 3), ("class", f"{order}u4"), ("label", f"{order}u4")]
    rows = np.zeros(sum(map(len, posts)), dtype=kind)
    numbers = np.repeat(np.arange(len(posts)), [len(points) for points in posts])
    rows["at"], rows["class"], rows["label"] = np.concatenate(posts), 80 + numbers % 2, numbers + 1
    header, body = _HEADER.format(storage, len(rows)).encode(), rows.tobytes()
    if rng.random() < 0.4:
        return mutate_text(header, rng) + body
    return header + mutate_bytes(body, rng).ljust(len(body), b"\0")[: len(body)]
