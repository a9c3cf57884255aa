"""ROS 2's CDR bytes -> messages, by the definition that the log itself carries: ``ros2msg`` or ``ros2idl``."""

from __future__ import annotations

import re
import struct
from collections.abc import Mapping
from functools import lru_cache
from typing import Any

from rosbags.serde import SerdeError
from rosbags.typesys import Stores, TypesysError, get_types_from_idl, get_types_from_msg, get_typestore
from rosbags.typesys.store import Typestore

from logs.topics import Schema
from logs.validation import Refusal

_DAMAGE = (SerdeError, struct.error, ValueError, IndexError, KeyError, OverflowError, MemoryError)
_SEPARATOR = re.compile(r"^={80}\nIDL: .*\n", re.MULTILINE)
_DIRECTIVE = re.compile(r"^\s*#.*$", re.MULTILINE)


def parse(schema: Schema, data: bytes) -> Any:
    """The message in ``data``: fields are attributes, as in Python nodes; arrays of numbers are NumPy arrays.

    Raises:
        Refusal: a definition that cannot be read, or bytes that are no such message.
    """
    store = _typestore(schema)
    try:
        return store.deserialize_cdr(data, schema.name)
    except _DAMAGE as error:
        raise Refusal("bytes do not decode", f"{len(data)} bytes as {schema.name}") from error


def constants_of(schema: Schema, type_name: str) -> Mapping[str, int | float | str | bool]:
    """The constants of ``type_name``, a part of the message of ``schema``, by name; none if there is no such part.

    Raises:
        Refusal: a definition that cannot be read.
    """
    constants, _ = _typestore(schema).fielddefs.get(type_name, ((), ()))
    return {name: value for name, _, value in constants}


@lru_cache(maxsize=64)
def _typestore(schema: Schema) -> Typestore:
    store = get_typestore(Stores.EMPTY)
    try:
        text = schema.data.decode()
        if schema.encoding == "ros2idl":
            # The library knows no directives of a preprocessor; what they include stands in the same text.
            parts = [_DIRECTIVE.sub("", part) for part in _SEPARATOR.split(text)]
            store.register({name: t for part in parts if part.strip() for name, t in get_types_from_idl(part).items()})
        else:
            store.register(get_types_from_msg(text, schema.name))
    except (TypesysError, SyntaxError, *_DAMAGE) as error:
        raise Refusal(f"definition of {schema.name} cannot be read", " ".join(str(error).split())[:200]) from error
    return store
