"""The layout for Foxglove that ships with the package."""

from __future__ import annotations

from pathlib import Path

_LAYOUT = Path(__file__).parent / "layouts" / "foxglove.json"


def read_foxglove_layout() -> str:
    """The layout as Foxglove imports it, JSON."""
    return _LAYOUT.read_text(encoding="utf-8")
