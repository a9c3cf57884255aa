"""A fixed vector for each class name, so that descriptors have one length for any vocabulary."""

import hashlib
from collections.abc import Sequence
from functools import lru_cache

import numpy as np

from descriptors.arrays import Float32Array


def class_vectors(names: Sequence[str], length: int) -> Float32Array:
    """Unit vectors (C, length) at random directions that depend on the name alone.

    Almost orthogonal, so a sum of them stands for the counts of the classes (random indexing); a class keeps its vector
    when the vocabulary grows, and in every other map.
    """
    return np.array([_class_vector(name, length) for name in names], np.float32).reshape(-1, length)


@lru_cache(maxsize=4096)
def _class_vector(name: str, length: int) -> Float32Array:
    seed = int.from_bytes(hashlib.sha256(name.encode()).digest()[:8], "little")
    vector = np.random.default_rng(seed).normal(size=length)
    return np.asarray(vector / np.linalg.norm(vector), dtype=np.float32)
