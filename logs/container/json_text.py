"""JSON that others wrote, and what ours may hold."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping
from dataclasses import fields, is_dataclass
from typing import Any

import numpy as np


def parse_json(text: str, **options: Any) -> Any:
    """What ``text`` says, in which no text holds half of a character (a lone surrogate): UTF-8 has none.

    Args:
        text: JSON.
        options: of ``json.loads``.

    Raises:
        ValueError: it is no JSON, nested too deeply, or holds a number of thousands of digits.
    """
    try:
        value = json.loads(text, **options)
        if "\\ud" in text.lower():
            value = json.loads(json.dumps(value, ensure_ascii=False).encode("utf-8", "replace"), **options)
    except RecursionError as error:
        raise ValueError("nested too deeply") from error
    return value


def plain(value: Any) -> Any:
    """Convert dataclasses, arrays and mappings to what JSON can hold; numbers that are not finite become None."""
    if is_dataclass(value):
        return {each.name: plain(getattr(value, each.name)) for each in fields(value)}
    if isinstance(value, Mapping):
        return {str(name): plain(each) for name, each in value.items()}
    if isinstance(value, np.ndarray | np.generic):
        return plain(value.tolist())
    if isinstance(value, tuple | list):
        return [plain(each) for each in value]
    return None if isinstance(value, float) and not math.isfinite(value) else value
