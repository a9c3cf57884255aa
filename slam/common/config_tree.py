"""Configuration trees: read from TOML and ``key=value`` overrides, refused in one line, written as commented TOML."""

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
from pydantic import BaseModel, ValidationError
from pydantic.fields import FieldInfo

from logs.container.json_text import parse_json
from logs.storage.regular_file import open_regular
from slam.common.errors import ConfigurationError
from slam.common.renamed_settings import RENAMED_SETTINGS

_Tree = TypeVar("_Tree", bound=BaseModel)

_FLAG = "--set"
_SMALLEST, _LARGEST = 1e-9, 1e9
_LARGEST_INTEGER = 2**31 - 1
_MOST_CHARACTERS = 10_000_000
_BOUNDS = ((annotated_types.Gt, "gt", ">"), (annotated_types.Ge, "ge", ">="), (annotated_types.Lt, "lt", "<"),
           (annotated_types.Le, "le", "<="))  # fmt: skip
_TYPE_NAMES = {float: "a number", int: "a whole number", bool: "true or false", str: "text"}


@dataclass(frozen=True, slots=True)
class Setting:
    """One value of a tree by its dotted key; ``default`` is the value itself where there is none."""

    key: str
    value: object
    default: object
    allowed: str
    meaning: str


def load_tree(model: type[_Tree], path: Path | None, overrides: Sequence[str]) -> _Tree:
    """The tree that defaults, then the TOML file ``path``, then ``overrides`` ("branch.key=value") make.

    Raises:
        ConfigurationError: a file that cannot be read, a key that does not exist (the nearest
            one is named, of a renamed one the new name), or a value
            that is not allowed (what is allowed is named).
    """
    try:
        return _load_tree(model, path, overrides)
    except RecursionError as error:
        where = _FLAG if path is None else str(path)
        raise ConfigurationError(f"{where}: values are nested too deeply; 'dslam config' lists the keys") from error


def _load_tree(model: type[_Tree], path: Path | None, overrides: Sequence[str]) -> _Tree:
    data = {} if path is None else _read_toml(path)
    _refuse_unknown(model, data, str(path))
    flagged: set[str] = set()
    for text in overrides:
        key, value = _parse_override(text)
        _set(data, key, value)
        _refuse_unknown(model, _nested(key, value), _FLAG)
        flagged.add(key)
    try:
        # By way of JSON, in which a list may become a tuple but a text never a number.
        tree = model.model_validate_json(json.dumps(data, default=str), strict=True)
    except ValidationError as error:
        raise _bad_value(model, error, data, flagged, path) from error
    _refuse_absurd(tree, flagged, path)
    return tree


def _refuse_absurd(tree: BaseModel, flagged: set[str], path: Path | None) -> None:
    """Numbers whose squares and quotients would not be numbers any more."""
    for setting in settings_of(tree):
        value = setting.value
        if isinstance(value, int) and abs(value) > _LARGEST_INTEGER:
            where = _FLAG if setting.key in flagged or path is None else str(path)
            raise ConfigurationError(
                f"{where}: {setting.key}={value} is absurd; whole numbers are at most {_LARGEST_INTEGER}: "
                f"{setting.meaning}"
            )
        if isinstance(value, float) and value != 0.0 and not _SMALLEST <= abs(value) <= _LARGEST:
            where = _FLAG if setting.key in flagged or path is None else str(path)
            raise ConfigurationError(
                f"{where}: {setting.key}={value:g} is absurd; numbers other than 0 are from {_SMALLEST:g} to "
                f"{_LARGEST:g}: {setting.meaning}"
            )


def settings_of(tree: BaseModel, prefix: str = "") -> Iterator[Setting]:
    """Every value of ``tree``, branch by branch; a branch that is None is left out."""
    for name, field in type(tree).model_fields.items():
        value = getattr(tree, name)
        if isinstance(value, BaseModel):
            yield from settings_of(value, f"{prefix}{name}.")
        elif _branch_of(field) is None:
            meaning = " ".join((field.description or "").split())
            default = value if field.is_required() else field.get_default()
            yield Setting(f"{prefix}{name}", value, default, _allowed(field), meaning)


CHANGED_SETTINGS = "changed_settings"
"""Metadata of a log beside its configuration: :func:`changed_settings`, so that reading it needs no model."""


def changed_settings(tree: BaseModel) -> str:
    """What is not the default, for people: "keyframe.distance_m=1.5, ..."."""
    return ", ".join(changes(type(tree)(), tree.model_dump_json()))


def changes(defaults: BaseModel, text: str) -> list[str]:
    """What a recorded configuration, JSON in ``text``, says otherwise than ``defaults``: "key=value" each."""
    # By way of JSON, as what is recorded.
    known = {setting.key: json.loads(json.dumps(setting.value)) for setting in settings_of(defaults)}
    try:
        recorded = dict(_leaves(parse_json(text)))
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
        changed = "" if setting.value == setting.default else f"; default {_toml_value(setting.default)}"
        value = f"# {name} is not set" if setting.value is None else f"{name} = {_toml_value(setting.value)}"
        lines += [f"# {setting.meaning} ({setting.allowed}{changed})", value]
    return "\n".join(lines).lstrip("\n") + "\n"


def _leaves(tree: Mapping[str, Any], prefix: str = "") -> Iterator[tuple[str, object]]:
    for name, value in tree.items():
        if isinstance(value, dict):
            yield from _leaves(value, f"{prefix}{name}.")
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
            text = stream.read(_MOST_CHARACTERS + 1)
        if len(text) > _MOST_CHARACTERS:
            raise ConfigurationError(f"{path} has more than {_MOST_CHARACTERS} characters; it is no file of settings")
        return tomllib.loads(text)
    except OSError as error:
        raise ConfigurationError(f"cannot read {path}: {error.strerror}; give the path of a TOML file") from error
    except ValueError as error:  # of TOML, of UTF-8, or a number with thousands of digits
        raise ConfigurationError(f"{path} is no TOML: {error}; 'dslam config' prints a file to start from") from error


def _parse_override(text: str) -> tuple[str, object]:
    key, equals, value = (part.strip() for part in text.partition("="))
    if not equals or not key or not value:
        raise ConfigurationError(f"{_FLAG} {text!r}: expected key=value, for example {_FLAG} keyframe.distance_m=1.5")
    try:
        return key, tomllib.loads(f"value = {value}")["value"]
    except ValueError:
        return key, value  # a word needs no quotes


def _nested(key: str, value: object) -> dict[str, Any]:
    tree: dict[str, Any] = {}
    _set(tree, key, value)
    return tree


def _set(tree: dict[str, Any], key: str, value: object) -> None:
    *branches, name = key.split(".")
    for branch in branches:
        inner = tree.setdefault(branch, {})
        if not isinstance(inner, dict):
            raise ConfigurationError(f"{_FLAG} {key}: {branch} is a value and has no keys of its own")
        tree = inner
    tree[name] = value


def _refuse_unknown(
    model: type[BaseModel], data: Mapping[str, Any], where: str, root: type[BaseModel] | None = None, prefix: str = ""
) -> None:
    root = root or model
    for name, value in data.items():
        key = f"{prefix}{name}"
        field = model.model_fields.get(name)
        branch = None if field is None else _branch_of(field)
        if field is None or (isinstance(value, dict) and branch is None and not _is_table(field)):
            raise ConfigurationError(
                f"{where}: there is no {_deepest(key, value)!r}; {_hint(root, _deepest(key, value))}"
            )
        if branch is not None and isinstance(value, dict):
            _refuse_unknown(branch, value, where, root, f"{key}.")


def _is_table(field: FieldInfo) -> bool:
    """Whether its keys are the user's own."""
    return get_origin(field.annotation) is dict


def _deepest(key: str, value: object) -> str:
    """The first dotted key under ``key``: what the user meant to set."""
    while isinstance(value, dict) and value:
        name, value = next(iter(value.items()))
        key = f"{key}.{name}"
    return key


def _hint(root: type[BaseModel], wanted: str) -> str:
    keys = list(_keys(root))
    renamed = RENAMED_SETTINGS.get(wanted)
    if renamed is not None and (renamed in keys or renamed in root.model_fields):
        return f"it was renamed to {renamed}"
    near = difflib.get_close_matches(wanted, keys, n=1, cutoff=0.6)
    by_name = [key for key in keys if key.rpartition(".")[2] == wanted.rpartition(".")[2]]
    if by_name or near:
        return f"did you mean {(by_name or near)[0]}?"
    return "'dslam config' lists the keys" if root.__name__ == "Config" else f"the keys are {', '.join(keys)}"


def _keys(model: type[BaseModel], prefix: str = "") -> Iterator[str]:
    for name, field in model.model_fields.items():
        branch = _branch_of(field)
        if branch is None:
            yield f"{prefix}{name}"
        else:
            yield from _keys(branch, f"{prefix}{name}.")


def _branch_of(field: FieldInfo) -> type[BaseModel] | None:
    annotation = field.annotation
    options = get_args(annotation) if get_origin(annotation) in (Union, types.UnionType) else (annotation,)
    return next((kind for kind in options if isinstance(kind, type) and issubclass(kind, BaseModel)), None)


def _allowed(field: FieldInfo) -> str:
    kind = field.annotation
    bounds = [
        f"{sign} {getattr(m, name):g}" for m in field.metadata for bound, name, sign in _BOUNDS if isinstance(m, bound)
    ]
    pattern = next((m.pattern for m in field.metadata if getattr(m, "pattern", None)), None)
    if pattern is not None:
        return "one of " + ", ".join(pattern.strip("^$()").split("|"))
    if get_args(kind) and all(isinstance(choice, str) for choice in get_args(kind)):
        return "one of " + ", ".join(get_args(kind))
    if get_origin(kind) is dict:
        return "a table of names"
    if get_origin(kind) is tuple:
        return "a list of names" if get_args(kind)[0] is str else "a list of numbers"
    name = _TYPE_NAMES.get(kind, str(kind)) if isinstance(kind, type) else str(kind)
    return " ".join([name, " and ".join(bounds)]).strip()


def _bad_value(
    model: type[BaseModel], error: ValidationError, data: Mapping[str, Any], flagged: set[str], path: Path | None
) -> ConfigurationError:
    first = error.errors()[0]
    key = ".".join(str(part) for part in first["loc"] if isinstance(part, str))
    is_flagged = any(f == key or key.startswith(f"{f}.") or f.startswith(f"{key.rpartition('.')[0]}.") for f in flagged)
    where = _FLAG if is_flagged or path is None else str(path)
    field: FieldInfo | None = None
    branch: type[BaseModel] | None = model
    value: Any = data
    for part in key.split("."):
        field = branch.model_fields.get(part) if branch else None
        branch = _branch_of(field) if field else None
        value = value.get(part) if isinstance(value, dict) else value
    if field is not None and first["type"] == "missing":
        return ConfigurationError(f"{where}: {key} is missing; it is {_allowed(field)}: {field.description}")
    if branch is not None:
        return ConfigurationError(f"{where}: {key} is a branch; set one of its keys: {', '.join(branch.model_fields)}")
    if field is None:
        return ConfigurationError(f"{where}: {key or 'configuration'}: {first['msg']}")
    shown = value if isinstance(value, float) and not math.isfinite(value) else json.dumps(value, default=str)
    return ConfigurationError(f"{where}: {key}={shown} is not allowed; it is {_allowed(field)}: {field.description}")
