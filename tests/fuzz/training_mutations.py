"""Mutated checkpoints of a training (torch) and weights (safetensors), in their trees, texts and numbers."""

from __future__ import annotations

import io
import json
from typing import Any

import numpy as np

from tests.fuzz.byte_mutations import FLOATS, INTEGERS, TEXTS, mutate_bytes
from tests.fuzz.log_mutations import mutate_json

_MAX_HEADER = 10**6


def mutate_checkpoint(content: bytes, rng: np.random.Generator) -> bytes:
    """A checkpoint with a few changes anywhere in its tree, or of its bytes."""
    import torch

    from descriptors.training.folder import DIGEST_BYTES

    if rng.random() < 0.2:
        return mutate_bytes(content, rng)
    digest, content = content[:DIGEST_BYTES], content[DIGEST_BYTES:]
    tree = torch.load(io.BytesIO(content), weights_only=True)
    for _ in range(int(rng.choice([1, 1, 2, 5]))):
        _mutate_node(tree, rng)
    out = io.BytesIO()
    torch.save(tree, out)
    return digest + out.getvalue()


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


def _mutate_node(node: Any, rng: np.random.Generator) -> None:
    """Go down the tree of dictionaries and lists, and alter one leaf or leave it out."""
    while True:
        keys = list(node) if isinstance(node, dict) else list(range(len(node)))
        if not keys:
            return
        key = keys[int(rng.integers(len(keys)))]
        if isinstance(node[key], (dict, list)) and node[key] and rng.random() < 0.85:
            node = node[key]
            continue
        if rng.random() < 0.15:
            del node[key]
        else:
            node[key] = _altered(node[key], rng)
        return


def _altered(value: Any, rng: np.random.Generator) -> Any:
    import torch

    if isinstance(value, torch.Tensor) and rng.random() < 0.8:
        match int(rng.integers(4)):
            case 0:
                return torch.full_like(value, float(rng.choice(FLOATS[:8])))
            case 1:
                return value.flatten()[: int(rng.integers(3))]
            case 2:
                return value.double()
            case _:
                return torch.cat([value.reshape(-1)] * 2)
    if isinstance(value, str) and rng.random() < 0.8:
        return mutate_json(value.encode(), rng).decode(errors="replace")
    return rng.choice(np.array([*FLOATS, *INTEGERS, *TEXTS[:8], None, True, [], {}], dtype=object))
