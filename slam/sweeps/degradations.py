"""Degradations as they are asked for: "dropout=0.3,position_noise=0.2", named like the options of ``dslam degrade``."""

from __future__ import annotations

import difflib
import math
from collections.abc import Sequence
from dataclasses import dataclass

from slam.common.errors import ConfigurationError
from slam.simulation.degradation import DegradationConfig, make_degradation

DEFAULT_SPECIFICATIONS = (
    "dropout=0.7",
    "position_noise=1",
    "label_confusion=0.5",
    "false_positives=10",
    "odometry_yaw_noise=0.005",
)

_SETTINGS = {
    "reversed": "reversed",
    "time_offset": "time_offset_s",
    "field_of_view": "field_of_view_deg",
    "max_range": "max_range_m",
    "keep_label": "keep_labels",
    "drop_label": "drop_labels",
    "dropout": "dropout",
    "label_confusion": "label_confusion",
    "position_noise": "position_noise_m",
    "false_positives": "false_positives",
    "odometry_translation_noise": "odometry_translation_noise",
    "odometry_yaw_noise": "odometry_yaw_noise",
}
_OPTIONS = {setting: option for option, setting in _SETTINGS.items()}
_WORDS = {"true": True, "false": False}


@dataclass(frozen=True, slots=True)
class Degradation:
    """One way to make a log worse; ``name`` is the same for two that do the same."""

    name: str
    config: DegradationConfig

    @property
    def is_undegraded(self) -> bool:
        """Whether the log stays as it is."""
        return not self.config.in_effect()

    @property
    def strength(self) -> tuple[str, float] | None:
        """The option and its value, where only one changes that is a number."""
        effects = self.config.in_effect()
        if len(effects) != 1:
            return None
        ((setting, value),) = effects.items()
        return (_OPTIONS[setting], float(value)) if _is_number(value) and isinstance(value, (int, float)) else None


def parse_degradations(specifications: Sequence[str]) -> list[Degradation]:
    """The log as it is, then each degradation once, in the order given.

    Raises:
        ConfigurationError: an option that does not exist, or a value that is not allowed.
    """
    found = [_named(DegradationConfig()), *(_parse(text) for text in specifications or DEFAULT_SPECIFICATIONS)]
    return list({degradation.name: degradation for degradation in found}.values())


def undegraded_strength(option: str) -> float | None:
    """The value of a numeric option that changes nothing; None where that is beyond all numbers."""
    default = getattr(DegradationConfig(), _SETTINGS[option])
    return float(default) if math.isfinite(default) else None


def describe_option(option: str) -> str:
    """A numeric option in words, with its unit: "position noise [m]"."""
    words, unit = option.replace("_", " "), _SETTINGS[option].removeprefix(option).removeprefix("_")
    return f"{words} [{unit}]" if unit else words


def _parse(text: str) -> Degradation:
    values: dict[str, object] = {}
    for part in text.split(","):
        option, equals, word = (piece.strip() for piece in part.partition("="))
        option = option.replace("-", "_")
        if option not in _SETTINGS:
            near = difflib.get_close_matches(option, _SETTINGS, n=1)
            hint = f"did you mean {near[0]}?" if near else f"there are {', '.join(_SETTINGS)}"
            raise ConfigurationError(f"--degrade {text!r}: there is no {option!r}; {hint}")
        setting = _SETTINGS[option]
        if isinstance(labels := getattr(DegradationConfig(), setting), tuple):
            if not word:
                raise ConfigurationError(f"--degrade {text!r}: {option} needs a label, for example {option}=tree")
            earlier = values.get(setting, labels)
            values[setting] = (*(earlier if isinstance(earlier, tuple) else ()), word)
        elif setting in values:
            raise ConfigurationError(f"--degrade {text!r}: {option} is given twice; give it once")
        else:
            values[setting] = _value(word) if equals else setting == "reversed" or ""
    try:
        return _named(make_degradation(values))
    except ConfigurationError as error:
        raise ConfigurationError(f"--degrade {text!r}: {error}") from error


def _named(config: DegradationConfig) -> Degradation:
    parts = []
    for setting, value in config.in_effect().items():
        option = _OPTIONS[setting]
        if isinstance(value, tuple):
            parts += [f"{option}={label}" for label in value]
        else:
            parts.append(f"{option}={value:g}" if _is_number(value) else option)
    return Degradation(",".join(parts) or "undegraded", config)


def _value(word: str) -> object:
    if word in _WORDS:
        return _WORDS[word]
    try:
        return float(word)
    except ValueError:
        return word


def _is_number(value: object) -> bool:
    return isinstance(value, (int, float)) and not isinstance(value, bool)
