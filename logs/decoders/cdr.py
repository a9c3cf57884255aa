"""Bytes of ROS 2 (CDR) -> messages, by the definition in the log: ``ros2msg`` or ``ros2idl``."""

import re
import struct
from functools import lru_cache
from typing import Any

from rosbags.interfaces import Nodetype
from rosbags.serde import SerdeError
from rosbags.typesys import Stores, TypesysError, get_types_from_idl, get_types_from_msg, get_typestore
from rosbags.typesys.store import Typestore

from logs.topics import RawMessage, Schema
from logs.validation import Refusal

_MAX_FIELDS = 1024
"""Of a message and all its parts; each element of an array of fixed length counts, as code is generated for it."""
_DAMAGE = (SerdeError, struct.error, ValueError, IndexError, KeyError, OverflowError, MemoryError)
_SEPARATOR = re.compile(r"^={80}\nIDL: .*\n", re.MULTILINE)
_DIRECTIVE = re.compile(r"^\s*#.*$", re.MULTILINE)


def parse(raw: RawMessage) -> Any:
    """The message in ``raw``: fields are attributes, as in Python nodes; arrays of numbers are NumPy arrays.

    Raises:
        Refusal: no definition or one that cannot be read, or bytes that are no such message.
    """
    schema = raw.channel.schema
    if schema is None:
        raise Refusal("no definition of the message in the log")
    store = _read_definition(schema)
    if isinstance(store, str):
        raise Refusal(f"definition of {schema.name} cannot be read", store)
    try:
        return store.deserialize_cdr(raw.data, schema.name)
    except _DAMAGE as error:
        raise Refusal("bytes do not decode", f"{len(raw.data)} bytes as {schema.name}") from error


@lru_cache(maxsize=64)
def _read_definition(schema: Schema) -> Typestore | str:
    """The types of a definition, or why it cannot be read; computed once for all its messages."""
    store = get_typestore(Stores.EMPTY)
    try:
        if len(schema.data) > 65_536:  # reading one takes 10 ms for each kilobyte
            raise ValueError(f"{len(schema.data)} bytes, more than 65536")
        text = schema.data.decode()
        if schema.encoding == "ros2idl":
            # The library knows no directives of a preprocessor; what they include stands in the same text.
            parts = [_DIRECTIVE.sub("", part) for part in _SEPARATOR.split(text)]
            store.register({name: t for part in parts if part.strip() for name, t in get_types_from_idl(part).items()})
        else:
            store.register(get_types_from_msg(text, schema.name))
        _count_fields(store, schema.name, depth=32)
    except (TypesysError, SyntaxError, RecursionError, *_DAMAGE) as error:
        return " ".join(str(error).split())[:200]
    return store


def _count_fields(store: Typestore, type_name: str, depth: int) -> int:
    """Number of a type and its parts, and of their fields.

    Raises:
        ValueError: there are more than ``_MAX_FIELDS``, or parts of parts more than ``depth`` times.
        KeyError: a part is not defined.
    """
    if depth == 0:
        raise ValueError("nested more than 32 levels deep")
    count = 1
    fielddefs: list[tuple[str, Any]] = list(store.fielddefs[type_name][1])
    for _, (kind, described) in fielddefs:
        is_array = kind in (Nodetype.ARRAY, Nodetype.SEQUENCE)
        (element_kind, element), length = described if is_array else ((kind, described), 1)
        fields = _count_fields(store, element, depth - 1) if element_kind == Nodetype.NAME else 1
        is_unrolled = kind == Nodetype.ARRAY and (element_kind == Nodetype.NAME or element[0] == "string")
        count += fields * max(length, 1) if is_unrolled else fields
        if count > _MAX_FIELDS:
            raise ValueError(f"more than {_MAX_FIELDS} fields in {type_name} and its parts")
    return count
