"""Mutations of the messages, topics, schemas and times of a log that stays a valid MCAP file."""

from __future__ import annotations

import json
from dataclasses import replace
from typing import Any

import numpy as np
from google.protobuf.descriptor import FieldDescriptor
from google.protobuf.message import DecodeError

from logs.decoders.protobuf import DECODERS
from tests.fuzz.byte_mutations import FLOATS, INTEGERS, TEXTS, mutate_bytes
from tests.fuzz.mcap_file import McapFile, Message, odd_layout, write_file

_TIMES = (0, 1, 2**31, 2**62, 2**63 - 1, 2**63, 2**64 - 1)
_RANGES = {
    FieldDescriptor.CPPTYPE_INT32: (-(2**31), 2**31 - 1),
    FieldDescriptor.CPPTYPE_UINT32: (0, 2**32 - 1),
    FieldDescriptor.CPPTYPE_INT64: (-(2**63), 2**63 - 1),
    FieldDescriptor.CPPTYPE_UINT64: (0, 2**64 - 1),
}


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
        elif encoding == "cdr":
            data = _mutate_cdr(message.data, one)
        elif encoding == "json":
            data = mutate_json(message.data, one)
        else:
            data = mutate_bytes(message.data, one)
        file.messages[i] = replace(message, data=data)


def _mutate_protobuf(name: str, data: bytes, rng: np.random.Generator) -> bytes:
    message = DECODERS[name][0]()
    try:
        message.ParseFromString(data)
    except DecodeError:
        return mutate_bytes(data, rng)
    for _ in range(int(rng.choice([1, 1, 3]))):
        _mutate_field(message, rng)
    return message.SerializeToString()


def _mutate_field(message: Any, rng: np.random.Generator) -> None:
    field = message.DESCRIPTOR.fields[int(rng.integers(len(message.DESCRIPTOR.fields)))]
    value = getattr(message, field.name)
    is_message = field.cpp_type == FieldDescriptor.CPPTYPE_MESSAGE
    if field.message_type is not None and field.message_type.GetOptions().map_entry:
        value.clear()
        return
    if field.is_repeated:
        if len(value) and is_message and rng.random() < 0.8:
            _mutate_field(value[int(rng.integers(len(value)))], rng)
            return
        match int(rng.integers(4)):
            case 0:
                del value[int(rng.integers(len(value) + 1)) :]
            case 1:
                value.extend(list(value) * int(rng.choice([1, 1, 50])))
            case _ if len(value) and not is_message:
                place = int(rng.integers(len(value)))
                if rng.random() < 0.3:
                    odd = _odd(field, rng)
                    value[:] = [odd for _ in value]
                else:
                    value[place] = _odd(field, rng)
        return
    if is_message:
        if rng.random() < 0.1:
            message.ClearField(field.name)
        else:
            _mutate_field(value, rng)
        return
    setattr(message, field.name, _odd(field, rng))


def _odd(field: FieldDescriptor, rng: np.random.Generator) -> Any:
    if field.cpp_type in (FieldDescriptor.CPPTYPE_DOUBLE, FieldDescriptor.CPPTYPE_FLOAT):
        return float(rng.choice(FLOATS))
    if field.cpp_type == FieldDescriptor.CPPTYPE_STRING:
        text = str(rng.choice(np.array(TEXTS, dtype=object)))
        return text.encode() if field.type == FieldDescriptor.TYPE_BYTES else text
    if field.cpp_type in _RANGES:
        low, high = _RANGES[field.cpp_type]
        return min(max(int(rng.choice(np.array(INTEGERS, dtype=object))), low), high)
    if field.cpp_type == FieldDescriptor.CPPTYPE_ENUM:
        return 0
    return bool(rng.integers(2))


def _mutate_cdr(data: bytes, rng: np.random.Generator) -> bytes:
    """Numbers at their alignment behind the four bytes of the header, else any bytes."""
    if rng.random() < 0.3 or len(data) < 16:
        return mutate_bytes(data, rng)
    altered = bytearray(data)
    if rng.random() < 0.5:
        place = 4 + 8 * int(rng.integers((len(data) - 4) // 8))
        altered[place : place + 8] = np.array([rng.choice(FLOATS)], dtype="<f8").tobytes()
    else:
        place = 4 + 4 * int(rng.integers((len(data) - 4) // 4))
        value = int(rng.choice(np.array(INTEGERS, dtype=object)))
        altered[place : place + 4] = (value % 2**32).to_bytes(4, "little")
    return bytes(altered)


def mutate_json(data: bytes, rng: np.random.Generator) -> bytes:
    """Another value, of another kind perhaps, at one place of the tree."""
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
        node[key] = rng.choice(np.array([*FLOATS, *INTEGERS, *TEXTS, None, True, [], {}], dtype=object))
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
    match int(rng.integers(3)):
        case 0:
            file.messages = [file.messages[i] for i in rng.permutation(len(file.messages))]
        case 1:
            file.messages = file.messages[::-1]
        case _:
            places = _some(file, rng)
            file.messages += [file.messages[i] for i in places[:200]]


def _drop(file: McapFile, rng: np.random.Generator) -> None:
    gone = set(_some(file, rng))
    file.messages = [m for i, m in enumerate(file.messages) if i not in gone]


def _topics(file: McapFile, rng: np.random.Generator) -> None:
    if not file.channels:
        return
    id = int(rng.choice(list(file.channels)))
    schema, topic, encoding = file.channels[id]
    match int(rng.integers(5)):
        case 0:
            topic = str(rng.choice(np.array(TEXTS, dtype=object)))
        case 1:
            topic = str(rng.choice([t for _, t, _ in file.channels.values()]))
        case 2:
            schema = int(rng.choice([0, 1, 2, 3, 65535]))
        case 3:
            encoding = str(rng.choice(["protobuf", "cdr", "json", "", "ros1"]))
        case _:
            new = int(rng.choice([0, 65535, 77]))
            file.channels[new] = (schema, topic + "2", encoding)
            return
    file.channels[id] = (schema, topic, encoding)


def _schemas(file: McapFile, rng: np.random.Generator) -> None:
    if not file.schemas:
        return
    id = int(rng.choice(list(file.schemas)))
    name, encoding, data = file.schemas[id]
    match int(rng.integers(4)):
        case 0:
            name = str(rng.choice([n for n, _, _ in file.schemas.values()]))
        case 1:
            encoding = str(rng.choice(["protobuf", "ros2msg", "ros2idl", "jsonschema", ""]))
        case 2 if encoding == "ros2msg":
            words = data.decode(errors="replace").split(" ")
            word = str(
                rng.choice(["string[1000000000]", "uint8[]", "std_msgs/Header", "geometry_msgs/Pose[]", "x", "="])
            )
            words[int(rng.integers(len(words)))] = word
            data = " ".join(words).encode()
        case _:
            data = mutate_bytes(data, rng)
    file.schemas[id] = (name, encoding, data)


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


def _many_objects(file: McapFile, rng: np.random.Generator) -> None:
    """Messages again and again at the same time."""
    places = _some(file, rng)[:1]
    for i in places:
        m = file.messages[i]
        file.messages += [Message(m.channel, m.log_time_ns, m.data, n) for n in range(int(rng.choice([2, 100])))]


_CHANGES = (_payloads, _payloads, _payloads, _payloads, _times, _order, _drop, _topics, _schemas, _metadata,
            _many_objects)  # fmt: skip
