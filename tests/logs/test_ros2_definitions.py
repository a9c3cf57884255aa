"""Definitions that ask for more than a message can need are refused, once."""

from collections import Counter

import pytest

from logs.decoders import cdr
from logs.decoders.decode import MAX_DEFINITIONS, RecordDecoder
from logs.topics import Channel, RawMessage, RecordKind, Schema
from logs.validation import Refusal

EMPTY = b"\0\1\0\0" + b"\0" * 8


def part(name: str, text: str) -> str:
    return "\n" + "=" * 80 + f"\nMSG: p/{name}\n{text}"


def refusal(text: str) -> str:
    channel = Channel("/topic", "cdr", Schema("p/msg/T", "ros2msg", text.encode()))
    with pytest.raises(Refusal) as error:
        cdr.parse(RawMessage(channel, 1, 1, 0, EMPTY))
    return str(error.value)


@pytest.mark.parametrize("text", [
    "string[1000000000] a",
    "p/E[1000000000] a" + part("E", "float64 x"),
    "p/A[100] a" + part("A", "p/B[100] b") + part("B", "string c"),
    "\n".join(f"float64 a{i}" for i in range(1025)),
    "p/A a\np/A b" + "".join(part(c, f"p/{d} a\np/{d} b") for c, d in zip("ABCDEFGHIJ", "BCDEFGHIJK", strict=True))
    + part("K", ""),
])  # fmt: skip
def test_too_many_fields_are_refused_before_code_is_generated_for_them(text):
    assert "more than 1024 fields" in refusal(text)


@pytest.mark.parametrize("text", [
    "p/T a",
    "p/T[] a\np/T[] b",
    "p/A[] a" + part("A", "p/B b") + part("B", "p/A a"),
])  # fmt: skip
def test_definitions_that_contain_themselves_are_refused(text):
    assert "nested more than 32 levels deep" in refusal(text)


def test_long_definitions_are_refused_unread():
    assert "bytes, more than 65536" in refusal("# " + "x" * 65_536 + "\nfloat64 a")


def test_large_arrays_of_numbers_are_no_matter():
    assert refusal("float64[1000000] a").startswith("bytes do not decode")


def test_a_refused_definition_is_not_read_for_each_message(monkeypatch):
    refusal("p/T again")
    monkeypatch.setattr(cdr, "get_typestore", lambda *_: pytest.fail("read again"))
    refusal("p/T again")


def test_a_log_with_many_definitions_is_read_in_part():
    decoder = RecordDecoder()
    for i in range(MAX_DEFINITIONS + 5):
        text = f"float64 x{i}".encode()
        channel = Channel("/odom", "cdr", Schema("nav_msgs/msg/Odometry", "ros2msg", text))
        decoder.records(RawMessage(channel, 1, 1, 0, EMPTY), [RecordKind.ODOMETRY])
    assert decoder.counters == Counter(invalid_messages=MAX_DEFINITIONS, undecodable=5)
