"""What is wrong with the outcome of a command: an empty list where nothing is."""

import json
import re
from pathlib import Path

from logs.storage.mcap_index import MAGIC
from tests.fuzz.sandbox import MEMORY_BYTES, SECONDS, Outcome
from tests.helpers.forked_commands import CRASHED

_FINE = (0, 1, 2)
_ESCAPES = re.compile(r"[\x00-\x08\x0b-\x1f\x7f\x80-\x9f]")
_SIGNALS = {-14: "hang", -24: "hang", -9: "killed", -11: "segmentation fault", -6: "abort", -25: "file too large"}


def judge(arguments: list[str], outputs: list[Path], outcome: Outcome) -> list[str]:
    """The complaints about one run; ``outputs`` are the files that it was to write."""
    found = []
    last = outcome.err.strip().splitlines()[-1] if outcome.err.strip() else ""
    if outcome.code not in _FINE:
        name = "crash" if outcome.code == CRASHED else _SIGNALS.get(outcome.code, f"exit {outcome.code}")
        found.append(f"{name}: {_shape(last)}")
    if outcome.seconds > SECONDS and outcome.code in _FINE:
        found.append("slow")
    if outcome.peak_bytes > MEMORY_BYTES // 2:
        found.append("memory")
    if "Warning:" in outcome.err:
        found.append(f"warning of a library: {_shape(next(x for x in outcome.err.splitlines() if 'Warning:' in x))}")
    if outcome.code == 2 and sum(line.startswith("dslam: ") for line in outcome.err.splitlines()) != 1:
        found.append(f"not one line on standard error: {_shape(last)}")
    if escapes := sorted(set(_ESCAPES.findall(outcome.out + outcome.err)) - {"\t", "\n"}):
        found.append(f"control characters {escapes} reach the terminal")
    if "--json" in arguments and outcome.code == 0:
        try:
            json.loads(outcome.out, parse_constant=_refuse)
        except ValueError as error:
            found.append(f"invalid JSON: {_shape(str(error))}")
    for output in outputs:
        found += _about(output, outcome)
    return found


def _about(output: Path, outcome: Outcome) -> list[str]:
    if outcome.code == 0 and not output.exists():
        return ["no output"]
    if outcome.code in (2, 70) and output.exists() and f"{output.name} is complete" not in outcome.err:
        return ["an output that was refused has its final name"]
    if output.exists() and output.suffix == ".mcap" and not output.read_bytes().endswith(MAGIC):
        return ["half-written log"]
    return []


def _refuse(constant: str) -> None:
    raise ValueError(f"JSON has no {constant}")


def _shape(text: str) -> str:
    """A message without its values, so that those of one cause count as one."""
    return re.sub(r"\d[\d.e+-]*", "#", re.sub(r"/\S+", "PATH", text))[:160]
