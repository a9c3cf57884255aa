"""Trees of settings, as frozen pydantic models: read from TOML and flags, written as TOML, and compared."""

from __future__ import annotations

import difflib
import json
import math
import tomllib
import types
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from io import TextIOWrapper
from pathlib import Path
from typing import Any, TypeVar, Union, get_args, get_origin

import annotated_types
from pydantic import BaseModel, ConfigDict, ValidationError
from pydantic.fields import FieldInfo

from logs.container.json_text import parse_json
from logs.storage.regular_file import open_regular
from slam.common.errors import ConfigurationError

_Tree = TypeVar("_Tree", bound=BaseModel)

_FLAG = "--set"
_SMALLEST, _MAX_ENTRY = 1e-9, 1e9
_LARGEST_INTEGER = 2**31 - 1
_MAX_CHARACTERS = 10_000_000
_SIGNS = {annotated_types.Gt: ("gt", ">"), annotated_types.Ge: ("ge", ">="), annotated_types.Lt: ("lt", "<"),
          annotated_types.Le: ("le", "<=")}  # fmt: skip
_TYPE_NAMES = {float: "a number", int: "a whole number", bool: "true or false", str: "text"}
RENAMED = {
    "calibration.enabled": "calibrate",
    "detection.redundancy": "calibration.detection.covariance_inflation",
    "association.active_radius_m": "calibration.detection.farthest_m",
    "association.confusion_distance_m": "calibration.objects.spacing_m",
    "landmark.confirm_fraction": "calibration.objects.detection_probability",
    "submap.sigma_per_m": "calibration.objects.landmark_sigma_per_m",
    "submap.travel_m": "calibration.detection.sensor_range_m",
    "loop_closure.base_sigma_m": "calibration.objects.landmark_sigma_m",
    "loop_closure.base_height_sigma_m": "calibration.objects.landmark_height_sigma_m",
    "loop_closure.neighbours": "loop_closure.top_k",
    "loop_closure.places": "loop_closure.max_candidates",
    "loop_closure.lost_places": "loop_closure.max_candidates",
    "loop_closure.max_candidates_when_lost": "loop_closure.max_candidates",
    "loop_closure.max_candidates_by_triangles": "loop_closure.max_candidates",
    "loop_closure.follow_travel_m": "loop_closure.propagation_distance_m",
    "limits": "memory_mb",
}
"""Old key, or old branch of keys, and the key that took its place."""
_NOW_CONSTANT = ("association", "evidence", "factor_graph", "landmark", "likelihood_ratio", "submap")
"""Branches of earlier versions that are constants of the program now."""


class Branch(BaseModel):
    """Settings that belong together: frozen, and without keys of other names."""

    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)

    def __hash__(self) -> int:
        """By the values, tables included, whose own type has no hash."""
        return hash(self.model_dump_json())


@dataclass(frozen=True, slots=True)
class Setting:
    """One value of a tree by its dotted key; ``default`` is the value itself where there is none."""

    key: str
    value: object
    default: object
    allowed: str
    meaning: str


def load_tree(
    model: type[_Tree], path: Path | None, overrides: Sequence[str], branches: Mapping[str, Path] | None = None
) -> _Tree:
    """The tree that defaults, then the TOML file ``path``, then files of single ``branches``, by their names, then
    ``overrides`` ("branch.key=value") make.

    Raises:
        ConfigurationError: a file that cannot be read, a key that does not exist (the nearest one is named, of a
            renamed one the new name), or a value that is not allowed (what is allowed is named).
    """
    try:
        data = {} if path is None else _read_toml(path)
        for branch, file in (branches or {}).items():
            within = data.setdefault(branch, {})
            for key, value in _read_toml(file).items():
                is_both = isinstance(value, dict) and isinstance(within.get(key), dict)
                within[key] = within[key] | value if is_both else value
        flagged = set[str]()
        for text in overrides:
            key, value = _parse_override(text)
            _set(data, key, value)
            flagged.add(key)
        # By way of JSON, in which a list may become a tuple but a text never a number.
        tree = model.model_validate_json(json.dumps(data, default=str), strict=True)
    except ValidationError as error:
        raise _refusal(model, error, flagged, path) from error
    except RecursionError as error:
        raise ConfigurationError(
            f"{path or _FLAG}: values are nested too deeply; 'dslam config' lists the keys"
        ) from error
    for setting in settings_of(tree):
        if absurd := _why_absurd(setting.value):
            where = _origin(setting.key, flagged, path)
            raise ConfigurationError(f"{where}: {setting.key}={setting.value} is absurd; {absurd}: {setting.meaning}")
    return tree


def settings_of(tree: BaseModel) -> Iterator[Setting]:
    """Every value of ``tree``, branch by branch; a branch that is None is left out."""
    for key, field in _leaves_of(type(tree)):
        holder: Any = tree
        *branches, name = key.split(".")
        for branch in branches:
            holder = None if holder is None else getattr(holder, branch)
        if holder is not None:
            value = getattr(holder, name)
            default = value if field.is_required() else field.get_default()
            yield Setting(key, value, default, _allowed(field), " ".join((field.description or "").split()))


CHANGED_SETTINGS = "changed_settings"
"""Metadata of a log beside its configuration: :func:`changed_settings`, so that reading it needs no model."""


def changed_settings(tree: BaseModel) -> str:
    """What is not the default, for people: "keyframe.distance_m=1.5, ..."."""
    return ", ".join(changes(type(tree)(), tree.model_dump_json()))


def changes(defaults: BaseModel, text: str) -> list[str]:
    """The values of a recorded configuration, JSON in ``text``, that differ from ``defaults``: "key=value" each."""
    # By way of JSON, as what is recorded.
    known = {setting.key: json.loads(json.dumps(setting.value)) for setting in settings_of(defaults)}
    try:
        recorded = dict(_flat(parse_json(text)))
    except (ValueError, AttributeError, RecursionError):
        return ["unreadable"]
    return [
        f"{key}={_toml_value(value)}"
        for key, value in recorded.items()
        if value is not None and value != known.get(key)
    ]


def to_toml(tree: BaseModel) -> str:
    """``tree`` as TOML that :func:`load_tree` reads back, with the meaning of each value above it."""
    lines: list[str] = []
    branch = ""
    for setting in sorted(settings_of(tree), key=lambda s: "." in s.key):  # values of the root stand before any branch
        head, _, name = setting.key.rpartition(".")
        if head != branch:
            lines += ["", f"[{head}]"]
            branch = head
        is_changed = setting.default is not None and setting.value != setting.default
        changed = f"; default {_toml_value(setting.default)}" if is_changed else ""
        value = f"# {name} is not set" if setting.value is None else f"{name} = {_toml_value(setting.value)}"
        lines += [f"# {setting.meaning} ({setting.allowed}{changed})", value]
    return "\n".join(lines).lstrip("\n") + "\n"


def _flat(tree: Mapping[str, Any], prefix: str = "") -> Iterator[tuple[str, object]]:
    for name, value in tree.items():
        if isinstance(value, dict):
            yield from _flat(value, f"{prefix}{name}.")
        else:
            yield f"{prefix}{name}", value


def _toml_value(value: object) -> str:
    """JSON's scalars and lists are TOML's; floats keep their point, so that they stay floats."""
    if isinstance(value, dict):
        pairs = ", ".join(f"{json.dumps(key)} = {_toml_value(inner)}" for key, inner in value.items())
        return f"{{ {pairs} }}" if pairs else "{}"
    return repr(value) if isinstance(value, float) else json.dumps(value, default=list)


def _read_toml(path: Path) -> dict[str, Any]:
    try:
        with TextIOWrapper(open_regular(path), encoding="utf-8-sig") as stream:
            text = stream.read(_MAX_CHARACTERS + 1)
        if len(text) > _MAX_CHARACTERS:
            raise ConfigurationError(f"{path} has more than {_MAX_CHARACTERS} characters; it is not a settings file")
        return tomllib.loads(text)
    except OSError as error:
        raise ConfigurationError(f"cannot read {path}: {error.strerror}; give the path of a TOML file") from error
    except ValueError as error:  # of TOML, of UTF-8, or a number with thousands of digits
        raise ConfigurationError(f"{path} is not TOML: {error}; 'dslam config' prints a file to start from") from error


def _parse_override(text: str) -> tuple[str, object]:
    key, equals, value = (part.strip() for part in text.partition("="))
    if not equals or not key or not value:
        raise ConfigurationError(f"{_FLAG} {text!r}: expected key=value, for example {_FLAG} keyframe.distance_m=1.5")
    try:
        return key, tomllib.loads(f"value = {value}")["value"]
    except ValueError:
        return key, value  # a word needs no quotes


def _set(tree: dict[str, Any], key: str, value: object) -> None:
    *branches, name = key.split(".")
    for branch in branches:
        inner = tree.setdefault(branch, {})
        if not isinstance(inner, dict):
            raise ConfigurationError(f"{_FLAG} {key}: {branch} is a value and has no keys of its own")
        tree = inner
    tree[name] = value


def _leaves_of(model: type[BaseModel], prefix: str = "") -> Iterator[tuple[str, FieldInfo]]:
    for name, field in model.model_fields.items():
        branch = _branch_of(field)
        if branch is None:
            yield f"{prefix}{name}", field
        else:
            yield from _leaves_of(branch, f"{prefix}{name}.")


def _branch_of(field: FieldInfo) -> type[BaseModel] | None:
    annotation = field.annotation
    options = get_args(annotation) if get_origin(annotation) in (Union, types.UnionType) else (annotation,)
    return next((kind for kind in options if isinstance(kind, type) and issubclass(kind, BaseModel)), None)


def _allowed(field: FieldInfo) -> str:
    kind: Any = field.annotation
    if get_origin(kind) in (Union, types.UnionType):
        kind = next(option for option in get_args(kind) if option is not type(None))
    bounds = [f"{_SIGNS[type(m)][1]} {getattr(m, _SIGNS[type(m)][0]):g}" for m in field.metadata if type(m) in _SIGNS]
    pattern = next((m.pattern for m in field.metadata if getattr(m, "pattern", None)), None)
    if pattern is not None:
        return "one of " + ", ".join(pattern.strip("^$()").split("|"))
    if get_args(kind) and all(isinstance(choice, str) for choice in get_args(kind)):
        return "one of " + ", ".join(get_args(kind))
    if get_origin(kind) is dict:
        return "a table of names"
    if get_origin(kind) is tuple:
        return "a list of names" if get_args(kind)[0] is str else "a list of numbers"
    return " ".join([_TYPE_NAMES.get(kind, str(kind)), " and ".join(bounds)]).strip()


def _why_absurd(value: object) -> str:
    """Of numbers whose squares and quotients are out of range; empty for all others."""
    if isinstance(value, int) and abs(value) > _LARGEST_INTEGER:
        return f"whole numbers are at most {_LARGEST_INTEGER}"
    if isinstance(value, float) and value != 0.0 and not _SMALLEST <= abs(value) <= _MAX_ENTRY:
        return f"numbers other than 0 are from {_SMALLEST:g} to {_MAX_ENTRY:g}"
    return ""


def _origin(key: str, flagged: set[str], path: Path | None) -> str:
    """Who gave the value of a key, or began its branch: the flag, or the file."""
    parent = key.rpartition(".")[0]
    is_flagged = any(f == key or f.startswith((f"{key}.", f"{parent}.")) or key.startswith(f"{f}.") for f in flagged)
    return _FLAG if is_flagged or path is None else str(path)


def _refusal(
    model: type[BaseModel], error: ValidationError, flagged: set[str], path: Path | None
) -> ConfigurationError:
    """The first unknown key, or else the first wrong value, in one line."""
    first = min(error.errors(), key=lambda each: each["type"] != "extra_forbidden")
    key = ".".join(str(part) for part in first["loc"] if isinstance(part, str))
    fields = dict(_leaves_of(model))
    if first["type"] == "extra_forbidden":
        wanted = _deepest(key, first["input"])
        return ConfigurationError(
            f"{_origin(wanted, flagged, path)}: there is no {wanted!r}; {_hint(list(fields), wanted)}"
        )
    where = _origin(key, flagged, path)
    if inner := [each.removeprefix(f"{key}.") for each in fields if each.startswith(f"{key}.")]:
        return ConfigurationError(f"{where}: {key} is a branch; set one of its keys: {', '.join(inner)}")
    key = next((each for each in fields if key == each or key.startswith(f"{each}.")), key)
    if key not in fields:
        return ConfigurationError(f"{where}: {key or 'configuration'}: {first['msg']}")
    expected = f"it is {_allowed(fields[key])}: {fields[key].description}"
    if first["type"] == "missing":
        return ConfigurationError(f"{where}: {key} is missing; {expected}")
    given = first["input"]
    shown = given if isinstance(given, float) and not math.isfinite(given) else json.dumps(given, default=str)
    return ConfigurationError(f"{where}: {key}={shown} is not allowed; {expected}")


def _deepest(key: str, value: object) -> str:
    """The first dotted key under ``key``: what the user meant to set."""
    while isinstance(value, dict) and value:
        name, value = next(iter(value.items()))
        key = f"{key}.{name}"
    return key


def _hint(keys: list[str], wanted: str) -> str:
    branch, _, name = wanted.rpartition(".")
    renamed = RENAMED.get(wanted, RENAMED.get(branch))
    if renamed in keys:
        return f"it was renamed to {renamed}"
    by_name = [key for key in keys if key.rpartition(".")[2] == name]
    near = by_name or difflib.get_close_matches(wanted, keys, n=1, cutoff=0.6)
    if branch in _NOW_CONSTANT and not by_name:
        return "it is a constant now; 'dslam config' lists the keys"
    return f"did you mean {near[0]}?" if near else "'dslam config' lists the keys"
