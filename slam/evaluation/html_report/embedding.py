"""Data and program inside a page, so that it needs nothing from outside."""

from __future__ import annotations

import base64
import gzip
import json
from functools import cache
from importlib import resources
from typing import Any


def embed_json(value: Any) -> str:
    """JSON that may stand inside ``<script>``: no character of it can end the element.

    Raises:
        ValueError: a number is not finite.
    """
    text = json.dumps(value, allow_nan=False, separators=(",", ":"), ensure_ascii=True)
    return text.replace("<", "\\u003c").replace(">", "\\u003e").replace("&", "\\u0026")


_START, _END = '\n"use strict";var Plotly=', "\nwindow.Plotly = Plotly;\n"


@cache
def compressed_plotly() -> str:
    """plotly.js of the installed plotly (MIT licence) as base64 of gzip, always the same bytes."""
    program = resources.files("plotly").joinpath("package_data", "plotly.min.js").read_text(encoding="utf-8")
    return base64.b64encode(gzip.compress(unwrap(program).encode(), 9, mtime=0)).decode("ascii")


def unwrap(program: str) -> str:
    """plotly.js with its licence, but without its wrapper for module loaders; another program as it is.

    A browser parses what is in the wrapper once more, which takes a third of the time that a page needs to open.
    """
    licence_end, start, end = program.find("*/") + 2, program.find(_START), program.rfind(_END)
    if not 2 <= licence_end <= start < end:
        return program
    return f"{program[:licence_end]}{program[start:end]}\n"


@cache
def read_part(name: str) -> str:
    """A file of this package: the style or the script of the page."""
    return resources.files(__package__).joinpath("assets", name).read_text(encoding="utf-8")
