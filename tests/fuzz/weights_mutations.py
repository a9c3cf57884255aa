"""Mutated weights (safetensors), in their header and in their numbers."""

from __future__ import annotations

import json

import numpy as np

from tests.fuzz.byte_mutations import FLOATS, mutate_bytes
from tests.fuzz.log_mutations import mutate_json

_MAX_HEADER = 10**6


def mutate_weights(content: bytes, rng: np.random.Generator) -> bytes:
    """Weights whose header is altered as the JSON that it is, or whose tensors are, with the right length of either."""
    size = int.from_bytes(content[:8], "little")
    if rng.random() < 0.2 or size > _MAX_HEADER:
        return mutate_bytes(content, rng)
    header, tensors = content[8 : 8 + size], content[8 + size :]
    match int(rng.integers(3)):
        case 0:
            header = mutate_json(header, rng)
        case 1:
            tree = json.loads(header)
            texts = tree["__metadata__"]
            name = str(rng.choice(list(texts)))
            texts[name] = mutate_json(texts[name].encode(), rng).decode(errors="replace")
            header = json.dumps(tree).encode()
        case _:
            values = np.frombuffer(tensors[: len(tensors) // 4 * 4], dtype="<f4").copy()
            with np.errstate(over="ignore"):
                value = np.float64(rng.choice(FLOATS)).astype("f4")
            values[rng.integers(len(values), size=int(rng.choice([1, 20])))] = value
            tensors = values.tobytes() + tensors[len(values) * 4 :]
    return len(header).to_bytes(8, "little") + header + tensors
