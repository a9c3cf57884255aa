"""Settings of a robot that is larger or smaller."""

import re
from typing import Any

from pydantic import BaseModel

POWER_OF_UNIT = {
    "m": 1.0,
    "m^2": 2.0,
    "1/m^3": -3.0,
    "m/s": 1.0,
    "m/s^2": 1.0,
    "rad / sqrt(m)": -0.5,
    "m / sqrt(m)": 0.5,
    "m / sqrt(s)": 1.0,
}
UNIT = re.compile(r"\[([^\]]+)\]")


def scaled_config(branch: Any, scale: float) -> dict[str, Any]:
    """The settings of a branch, with each length scaled."""
    values: dict[str, Any] = {}
    for name, info in type(branch).model_fields.items():
        value = getattr(branch, name)
        if value is None:
            continue
        if isinstance(value, BaseModel):
            values[name] = scaled_config(value, scale)
            continue
        unit = UNIT.search(info.description or "")
        power = POWER_OF_UNIT.get(unit.group(1), 0.0) if unit else 0.0
        values[name] = value * scale**power if power else value
    return values
