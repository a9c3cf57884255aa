"""Trees of settings, as frozen pydantic models: read from TOML and flags, written as TOML, and compared."""

import difflib
import json
import tomllib
from collections.abc import Iterator, Mapping, Sequence
from io import TextIOWrapper
from pathlib import Path
from typing import Any, TypeVar, get_args

from pydantic import BaseModel, ConfigDict, ValidationError
from pydantic.fields import FieldInfo

from logs.records import frozen
from logs.storage.regular_file import open_regular
from slam.common.errors import ConfigurationError

_Tree = TypeVar("_Tree", bound=BaseModel)

_FLAG = "--set"
_SMALLEST, _LARGEST = 1e-9, 2**31 - 1
"""Squares and quotients of numbers between them are in range, and so are whole numbers of 32 bits."""
_MAX_CHARACTERS = 10_000_000
_BOUNDS = {"gt": ">", "ge": ">=", "lt": "<", "le": "<="}
_TYPE_NAMES = {
    "float": "a number",
    "int": "a whole number",
    "bool": "true or false",
    "str": "text",
    "dict": "a table of names",
    "tuple": "a list of names",
}


class Branch(BaseModel):
    """Settings that belong together: frozen, and without keys of other names. The docstring of each is its meaning."""

    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False, use_attribute_docstrings=True)

    def __hash__(self) -> int:
        """By the values, tables included, whose own type has no hash."""
        return hash(self.model_dump_json())


@frozen
class Setting:
    """One value of a tree by its dotted key; ``default`` is the value itself where there is none."""

    key: str
    value: object
    default: object
    allowed: str
    meaning: str


def load_tree(
    model: type[_Tree], path: Path | None, overrides: Sequence[str] | None, calibration: Path | None = None
) -> _Tree:
    """The tree that defaults, then the TOML file ``path``, then that of the branch ``calibration``, then ``overrides``
    ("branch.key=value") make.

    Raises:
        ConfigurationError: a file that cannot be read, a key that does not exist (the nearest one is named), or a value
            that is not allowed.
    """
    flagged = set()
    try:
        data = {} if path is None else _read_toml(path)
        if calibration is not None:
            _update(data, {"calibration": _read_toml(calibration)})
        for text in overrides or ():
            key, value = _parse_override(text)
            *parents, name = key.split(".")
            given = {name: value}
            for parent in reversed(parents):
                given = {parent: given}
            _update(data, given)
            flagged.add(key)
        # By way of JSON, in which a list may become a tuple but a text never a number.
        tree = model.model_validate_json(json.dumps(data, default=str), strict=True)
    except ValidationError as error:
        raise _refusal(model, error, flagged, path) from error
    except RecursionError as error:
        raise ConfigurationError(
            f"{path or _FLAG}: values are nested too deeply; 'dslam config' lists the keys"
        ) from error
    for each in settings_of(tree):
        if isinstance(each.value, int | float) and each.value and not _SMALLEST <= abs(each.value) <= _LARGEST:
            limits = f"numbers other than 0 must be from {_SMALLEST:g} to {_LARGEST}"
            raise ConfigurationError(
                f"{_origin(each.key, flagged, path)}: {each.key}={each.value} is out of range; {limits}"
            )
    return tree


def settings_of(tree: BaseModel, prefix: str = "") -> Iterator[Setting]:
    """Every value of ``tree``, those of a branch before its branches; a branch that is None is left out."""
    branches = []
    for name, field in type(tree).model_fields.items():
        value = getattr(tree, name)
        if isinstance(value, BaseModel):
            branches.append((name, value))
        elif not any(isinstance(kind, type) and issubclass(kind, BaseModel) for kind in get_args(field.annotation)):
            default = value if field.is_required() else field.get_default()
            meaning = " ".join((field.description or "").split())
            yield Setting(f"{prefix}{name}", value, default, _allowed(field), meaning)
    for name, branch in branches:
        yield from settings_of(branch, f"{prefix}{name}.")


CHANGED_SETTINGS = "changed_settings"
"""Metadata of a log beside its configuration: :func:`changed_settings`, so that reading it needs no model."""


def changed_settings(tree: BaseModel) -> str:
    """Settings that differ from the defaults: "keyframe.distance_m=1.5, ..."."""
    changed = (each for each in settings_of(tree) if each.value is not None and each.value != each.default)
    return ", ".join(f"{each.key}={_toml_value(each.value)}" for each in changed)


def to_toml(tree: BaseModel) -> str:
    """``tree`` as TOML that :func:`load_tree` reads back, with the meaning of each value above it."""
    lines = []
    branch = ""
    for setting in settings_of(tree):
        head, _, name = setting.key.rpartition(".")
        if head != branch:
            lines += ["", f"[{head}]"]
            branch = head
        is_changed = setting.default is not None and setting.value != setting.default
        changed = f"; default {_toml_value(setting.default)}" if is_changed else ""
        value = f"# {name} is not set" if setting.value is None else f"{name} = {_toml_value(setting.value)}"
        lines += [f"# {setting.meaning} ({setting.allowed}{changed})", value]
    return "\n".join(lines).lstrip("\n") + "\n"


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


def _parse_override(text: str) -> tuple[str, Any]:
    key, equals, value = (part.strip() for part in text.partition("="))
    if not equals or not key or not value:
        raise ConfigurationError(f"{_FLAG} {text!r}: expected key=value, for example {_FLAG} keyframe.distance_m=1.5")
    zero = "0" if value.startswith(".") else ""  # which TOML demands
    try:
        return key, tomllib.loads(f"value = {zero}{value}")["value"]
    except ValueError:
        return key, value  # a word needs no quotes


def _update(tree: dict[str, Any], other: Mapping[str, Any]) -> None:
    """Put the values of ``other`` into ``tree``, branch by branch."""
    for name, value in other.items():
        if isinstance(value, dict) and isinstance(tree.get(name), dict):
            _update(tree[name], value)
        else:
            tree[name] = value


def _allowed(field: FieldInfo) -> str:
    kind = str(getattr(field.annotation, "__name__", field.annotation)).removesuffix(" | None")
    name = _TYPE_NAMES.get(kind.partition("[")[0], kind)
    bounds = [f"{sign} {getattr(m, key):g}" for m in field.metadata for key, sign in _BOUNDS.items() if hasattr(m, key)]
    return " ".join([name, " and ".join(bounds)]).strip()


def _origin(key: str, flagged: set[str], path: Path | None) -> str:
    """Who gave the value of a key, or began its branch: the flag, or the file."""
    parent = key.rpartition(".")[0]
    is_flagged = any(f.startswith((key, f"{parent}.")) or key.startswith(f"{f}.") for f in flagged)
    return _FLAG if is_flagged or path is None else str(path)


def _refusal(
    model: type[BaseModel], error: ValidationError, flagged: set[str], path: Path | None
) -> ConfigurationError:
    """The first unknown key, or else the first wrong value, in one line."""
    first = min(error.errors(), key=lambda each: each["type"] != "extra_forbidden")
    key, given = ".".join(str(part) for part in first["loc"] if isinstance(part, str)), first["input"]
    where = _origin(key, flagged, path)
    if first["type"] == "extra_forbidden":
        wanted = key
        while isinstance(given, dict) and given:  # what the user meant to set
            name, given = next(iter(given.items()))
            wanted = f"{wanted}.{name}"
        return ConfigurationError(f"{where}: there is no {wanted!r}; {_hint(model, wanted)}")
    meaning = next((f": {each.meaning}" for each in settings_of(model.model_construct()) if each.key == key), "")
    if first["type"] == "missing":
        return ConfigurationError(f"{where}: {key} is missing{meaning}")
    shown = json.dumps(given, default=str)[:60]
    return ConfigurationError(f"{where}: {key}={shown} is not allowed; {first['msg']}{meaning}")


def _hint(model: type[BaseModel], wanted: str) -> str:
    keys = [setting.key for setting in settings_of(model.model_construct())]
    by_name = [key for key in keys if key.rpartition(".")[2] == wanted.rpartition(".")[2]]
    near = by_name or difflib.get_close_matches(wanted, keys, n=1, cutoff=0.6)
    return f"did you mean {near[0]}?" if near else "'dslam config' lists the keys"
