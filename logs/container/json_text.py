"""What JSON may hold."""

from typing import Any

from pydantic_core import to_jsonable_python


def plain(value: Any) -> Any:
    """Convert dataclasses, arrays and mappings to what JSON can hold; numbers that are not finite become None."""
    return to_jsonable_python(value, inf_nan_mode="null", fallback=lambda array: array.tolist())
