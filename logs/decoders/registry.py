"""Schema name and encoding -> decoder, and the kinds of records that it can give."""

from __future__ import annotations

from collections.abc import Callable

from logs.decoders import protobuf, ros2
from logs.decoders.parts import Context, MessageDecoder, Records
from logs.topics import Channel, RecordKind

Decoder = Callable[[Context], Records]
"""Gives the records of one message for the part that its topic plays; raises Refusal for values no record may have."""

_DEFINITIONS = ("ros2msg", "ros2idl")
"""Encodings of definitions of ROS 2."""


def kinds_of(channel: Channel) -> tuple[RecordKind, ...]:
    """What the messages of ``channel`` can be decoded to; () for a schema or an encoding that is not known."""
    known: MessageDecoder | None = None
    if channel.message_encoding in ("protobuf", "json"):
        known = protobuf.DECODERS.get(channel.schema_name)
    elif channel.message_encoding == "cdr" and channel.schema and channel.schema.encoding in _DEFINITIONS:
        known = ros2.DECODERS.get(channel.schema_name)
    return known.kinds if known is not None else ()


def decoder_of(channel: Channel) -> Decoder:
    """The decoder of a ``channel`` of which ``kinds_of`` knows any."""
    return ros2.decode if channel.message_encoding == "cdr" else protobuf.decode
