"""Mutations of the messages, topics, schemas and times of a log that stays a valid MCAP file."""

from __future__ import annotations

import json
from dataclasses import replace
from typing import Any

import numpy as np
from google.protobuf.json_format import MessageToDict, ParseDict, ParseError
from google.protobuf.message import DecodeError

from logs.decoders.protobuf import DECODERS
from tests.fuzz.byte_mutations import FLOATS, INTEGERS, TEXTS, mutate_bytes
from tests.fuzz.mcap_file import McapFile, odd_layout, write_file

_TIMES = (0, 1, 2**31, 2**62, 2**63 - 1, 2**63, 2**64 - 1)
_ENCODINGS = ("protobuf", "cdr", "json", "ros2msg", "ros2idl", "jsonschema", "")
_WORDS = (b"string[1000000000]", b"uint8[]", b"std_msgs/Header", b"geometry_msgs/Pose[]", b"x", b"=")


def mutate_log(file: McapFile, rng: np.random.Generator) -> bytes:
    """The bytes of a log that is ``file`` but for a few changes."""
    file = file.copy()
    for _ in range(int(rng.choice([0, 1, 1, 2, 5]))):
        rng.choice(np.array(_CHANGES, dtype=object))(file, rng)
    content = write_file(file, odd_layout(rng))
    return mutate_bytes(content, rng) if rng.random() < 0.25 else content


def _some(file: McapFile, rng: np.random.Generator) -> list[int]:
    """Places of one message, of a run of them, or of all on a topic."""
    if not file.messages:
        return []
    place = int(rng.integers(len(file.messages)))
    match int(rng.integers(3)):
        case 0:
            return [place]
        case 1:
            return list(range(place, min(place + 20, len(file.messages))))
        case _:
            channel = file.messages[place].channel
            return [i for i, m in enumerate(file.messages) if m.channel == channel]


def _payloads(file: McapFile, rng: np.random.Generator) -> None:
    seed = int(rng.integers(2**32))
    is_same = rng.random() < 0.7
    for i in _some(file, rng):
        message = file.messages[i]
        one = np.random.default_rng(seed) if is_same else rng
        schema, _, encoding = file.channels.get(message.channel, (0, "", ""))
        name = file.schemas.get(schema, ("", "", b""))[0]
        if encoding == "protobuf" and name in DECODERS:
            data = _mutate_protobuf(name, message.data, one)
        elif encoding == "json":
            data = mutate_json(message.data, one)
        else:
            data = mutate_bytes(message.data, one)
        file.messages[i] = replace(message, data=data)


def _mutate_protobuf(name: str, data: bytes, rng: np.random.Generator) -> bytes:
    """By way of JSON; where protobuf has no place for the odd value, any bytes."""
    try:
        tree = json.dumps(MessageToDict(DECODERS[name].message_class.FromString(data)), allow_nan=False).encode()
        altered = json.loads(mutate_json(tree, rng), parse_constant=str)
        return bytes(ParseDict(altered, DECODERS[name].message_class()).SerializeToString())
    except (DecodeError, ParseError, ValueError, TypeError, AttributeError):
        return mutate_bytes(data, rng)


def mutate_json(data: bytes, rng: np.random.Generator) -> bytes:
    """Another value, mostly of the same kind, at one place of the tree; or a list of another length."""
    if rng.random() < 0.2:
        return mutate_bytes(data, rng)
    try:
        tree = node = json.loads(data)
    except ValueError:
        return mutate_bytes(data, rng)
    while isinstance(node, (dict, list)) and node:
        keys = list(node) if isinstance(node, dict) else range(len(node))
        key: Any = keys[int(rng.integers(len(keys)))]
        if isinstance(node[key], (dict, list)) and node[key] and rng.random() < 0.9:
            node = node[key]
            continue
        if isinstance(node[key], list) and rng.random() < 0.7:
            node[key] = node[key] * int(rng.choice([0, 2, 50]))
            break
        odd = np.array([*FLOATS, *INTEGERS, *TEXTS, None, True, [], {}], dtype=object)
        alike = [value for value in odd if type(value) is type(node[key])] if rng.random() < 0.7 else []
        node[key] = alike[int(rng.integers(len(alike)))] if alike else rng.choice(odd)
        break
    return json.dumps(tree).encode()


def _times(file: McapFile, rng: np.random.Generator) -> None:
    time_ns = int(rng.choice(np.array(_TIMES, dtype=object)))
    shift_ns = int(rng.integers(-(10**10), 10**10))
    is_shift = rng.random() < 0.5
    for i in _some(file, rng):
        m = file.messages[i]
        shifted = min(max(m.log_time_ns + shift_ns, 0), 2**64 - 1)
        file.messages[i] = replace(m, log_time_ns=shifted if is_shift else time_ns)


def _order(file: McapFile, rng: np.random.Generator) -> None:
    every = range(len(file.messages))
    some = _some(file, rng)
    orders = (rng.permutation(every), every[::-1], [*every, *some[:200]], [*every, *some[:1] * 100])
    file.messages = [file.messages[i] for i in orders[int(rng.integers(len(orders)))]]


def _drop(file: McapFile, rng: np.random.Generator) -> None:
    gone = set(_some(file, rng))
    file.messages = [m for i, m in enumerate(file.messages) if i not in gone]


def _definitions(file: McapFile, rng: np.random.Generator) -> None:
    """Another value in one field of a channel or of a schema, which may be there under another number, too."""
    table: dict[int, Any] = file.channels if rng.random() < 0.5 else file.schemas
    if not table:
        return
    number = int(rng.choice(list(table)))
    values = list(table[number])
    place = int(rng.integers(len(values)))
    match values[place]:
        case int():
            values[place] = int(rng.choice([0, 1, 2, 3, 65535]))
        case str():
            others = [each[place] for each in table.values()]
            values[place] = str(rng.choice(np.array([*TEXTS, *_ENCODINGS, *others], dtype=object)))
        case bytes() as text:
            words = text.split(b" ")
            words[int(rng.integers(len(words)))] = bytes(rng.choice(_WORDS))
            values[place] = b" ".join(words) if rng.random() < 0.5 else mutate_bytes(text, rng)
    table[int(rng.choice([*[number] * 4, 0, 77, 65535]))] = tuple(values)


def _metadata(file: McapFile, rng: np.random.Generator) -> None:
    text = str(rng.choice(np.array(TEXTS, dtype=object)))
    for i, (name, values) in enumerate(file.metadata):
        if values and rng.random() < 0.5:
            key = list(values)[int(rng.integers(len(values)))]
            value = values[key]
            other = mutate_bytes(value.encode(), rng).decode(errors="replace") if rng.random() < 0.5 else text
            file.metadata[i] = (name, {**values, key: other})
    if rng.random() < 0.3:
        file.metadata.append((text, {text: text}))
    if rng.random() < 0.1:
        file.metadata.clear()


_CHANGES = (*[_payloads] * 4, _times, _order, _drop, *[_definitions] * 2, _metadata)
