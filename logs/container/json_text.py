"""JSON that others wrote."""

from __future__ import annotations

import json
from typing import Any


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
