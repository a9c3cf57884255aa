"""Mutations of trees, as JSON has them, and of a log that stays a valid MCAP file."""

import json
import struct
from dataclasses import replace
from typing import Any

import numpy as np
from google.protobuf.json_format import MessageToDict, ParseDict, ParseError
from google.protobuf.message import DecodeError

from logs.decoders.protobuf import DECODERS
from tests.fuzz.byte_mutations import FLOATS, INTEGERS, TEXTS, mutate_bytes, one_of
from tests.fuzz.mcap_file import McapFile, odd_layout, write_file

_WORDS = (*TEXTS, "protobuf", "cdr", "json", "ros2msg", "ros2idl", "jsonschema")
_ROS_WORDS = (b"string[1000000000]", b"uint8[]", b"std_msgs/Header", b"geometry_msgs/Pose[]", b"x", b"=")
_TIMES = (0, 1, 2**31, 2**62, 2**63 - 1, 2**63, 2**64 - 1)


def mutate_log(file: McapFile, rng: np.random.Generator) -> bytes:
    """The bytes of a log that is ``file`` but for a few changes."""
    altered, layout = file.copy(), odd_layout(rng)
    try:
        for _ in range(int(rng.choice([0, 1, 1, 2, 5]))):
            if altered.messages and rng.random() < 0.6:
                _change_messages(altered, rng)
            else:
                _mutate_tree([altered.schemas, altered.channels, altered.metadata], rng)
        content = write_file(altered, layout)
    except (ValueError, TypeError, AttributeError, LookupError, struct.error):  # MCAP has no place for it
        content = write_file(file, layout)
    return mutate_bytes(content, rng) if rng.random() < 0.25 else content


def _change_messages(file: McapFile, rng: np.random.Generator) -> None:
    """Other content or times of one message, of a run of them or of all on a topic; or elsewhere, never or often."""
    place = int(rng.integers(len(file.messages)))
    channel = file.messages[place].channel
    of_channel = [i for i, each in enumerate(file.messages) if each.channel == channel]
    rows = ([place], list(range(place, min(place + 20, len(file.messages)))), of_channel)[int(rng.integers(3))]
    some = [file.messages[i] for i in rows]
    match int(rng.integers(6)):
        case 0:
            time_ns, shift_ns = int(one_of(_TIMES, rng)), int(rng.integers(-(10**10), 10**10))
            is_shift = rng.random() < 0.5
            times_ns = [min(max(each.log_time_ns + shift_ns, 0), 2**64 - 1) if is_shift else time_ns for each in some]
            some = [replace(each, log_time_ns=at_ns) for each, at_ns in zip(some, times_ns, strict=True)]
        case 1:
            some = some[:200] * int(rng.choice([0, 1, 2, 50]))
        case _:
            seed, is_same = int(rng.integers(2**32)), rng.random() < 0.7
            some = [
                replace(each, data=_mutate_data(file, each.channel, each.data, np.random.default_rng((seed, number))))
                for each, number in zip(some, [0] * len(some) if is_same else range(len(some)), strict=True)
            ]
    others = [each for i, each in enumerate(file.messages) if i not in rows]
    at = int(rng.choice([rows[0], 0, len(others)], p=[0.6, 0.2, 0.2]))
    file.messages = [*others[:at], *some, *others[at:]]


def _mutate_data(file: McapFile, channel: int, data: bytes, rng: np.random.Generator) -> bytes:
    """A message, of protobuf by way of JSON; where that has no place for the odd value, any bytes."""
    schema, _, encoding = file.channels[channel]
    name = file.schemas[schema][0] if schema in file.schemas else ""
    if encoding == "json":
        return mutate_json(data, rng)
    if encoding != "protobuf" or name not in DECODERS:
        return mutate_bytes(data, rng)
    try:
        tree = MessageToDict(DECODERS[name].message_class.FromString(data))
        _mutate_tree(tree, rng)
        return bytes(ParseDict(tree, DECODERS[name].message_class()).SerializeToString())
    except (DecodeError, ParseError, ValueError, TypeError, AttributeError):
        return mutate_bytes(data, rng)


def mutate_json(data: bytes, rng: np.random.Generator) -> bytes:
    """Another value at one place of the tree; or other bytes."""
    try:
        tree = json.loads(data)
    except ValueError:
        return mutate_bytes(data, rng)
    if rng.random() < 0.2:
        return mutate_bytes(data, rng)
    _mutate_tree(tree, rng, alike=0.7)
    return json.dumps(tree).encode()


def _mutate_tree(node: Any, rng: np.random.Generator, *, alike: float = 1.0) -> None:
    """Put another value at one place, of the same kind with the probability ``alike``; or change a list's length."""
    while isinstance(node, (dict, list)) and node:
        key: Any = list(node if isinstance(node, dict) else range(len(node)))[int(rng.integers(len(node)))]
        value = node[key]
        if isinstance(value, (dict, list)) and value and rng.random() < 0.9:
            node = value
            continue
        if isinstance(value, list):
            node[key] = value * int(rng.choice([0, 2, 50])) if rng.random() < alike else None
        elif isinstance(value, bytes):
            words = value.split(b" ")
            words[int(rng.integers(len(words)))] = bytes(rng.choice(_ROS_WORDS))
            node[key] = b" ".join(words) if rng.random() < 0.5 else mutate_bytes(value, rng)
        else:
            odd = np.array([*FLOATS, *INTEGERS, 2, 3, *_WORDS, None, True, [], {}], dtype=object)
            chosen = [each for each in odd if type(each) is type(value) or rng.random() >= alike]
            node[key] = chosen[int(rng.integers(len(chosen)))] if chosen else value
        return
