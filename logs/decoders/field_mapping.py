"""Detections in messages of any schema, by the names of their fields: "plants[] position=position label=kind".

Before the first blank stands the field with the list of objects (nothing, for a message that is one object), then for
each part of a detection the field that holds it: ``position`` (x, y and z in it, or three numbers), or ``x``, ``y`` and
``z``; and perhaps ``label`` and ``score``. A field in a field is "a.b". Stamp and frame are those of the field
``header``, as ROS has it, else the log time and the body.
"""

import json
from collections.abc import Mapping
from typing import Any

from logs.decoders.parts import Context, Detection, Records, detection_records
from logs.errors import TopicSelectionError
from logs.records import frozen
from logs.topics import RawMessage
from logs.validation import Refusal, stamp_ns

_PARTS = ("position", "x", "y", "z", "label", "score")


@frozen
class FieldMapping:
    """Where the detections of a message are: the field with their list, and the field of each of their parts."""

    objects: str
    fields: Mapping[str, str]

    @staticmethod
    def parse(text: str) -> "FieldMapping":
        """The mapping that ``text`` describes.

        Raises:
            TopicSelectionError: it names no position, or an unknown part.
        """
        objects, *pairs = text.split(" ")
        fields = {part: field for part, _, field in (pair.partition("=") for pair in pairs if pair)}
        has_place = "position" in fields or {"x", "y"} <= fields.keys()
        if not has_place or not fields.keys() <= {*_PARTS}:
            raise TopicSelectionError(
                f"{text!r} is not a field mapping; write for example 'plants[] position=position label=kind' with the "
                f"parts {', '.join(_PARTS)}"
            )
        return FieldMapping(objects.removesuffix("[]"), fields)

    def decode(self, context: Context) -> Records:
        """The records of a message.

        Raises:
            Refusal: bytes that are no such message, or a field that is not there.
        """
        message = _tree(context.raw)
        objects = _field(message, self.objects) if self.objects else message
        found = [self._detection(each) for each in (objects if isinstance(objects, list) else [objects])]
        header = None if isinstance(message, list) else _members(message).get("header")
        place = context.raw.log_time_ns, ""
        if header is not None:
            seconds, nanoseconds = _field(header, "stamp.sec"), _field(header, "stamp.nanosec")
            place = stamp_ns(seconds, nanoseconds, place[0]), str(_field(header, "frame_id"))
        return detection_records({place: found}, context.counters)

    def _detection(self, item: Any) -> Detection:
        parts = {part: _field(item, path) for part, path in self.fields.items()}
        return Detection(
            _xyz(parts.get("position", parts)), str(parts.get("label", "")), float(parts.get("score", 1.0))
        )


def _tree(raw: RawMessage) -> Any:
    if raw.channel.message_encoding == "json":
        return json.loads(raw.data)
    if raw.channel.message_encoding != "cdr":
        raise Refusal("fields are mapped in JSON and ROS messages", f"encoding {raw.channel.message_encoding!r}")
    from logs.decoders.cdr import parse  # loads rosbags

    return parse(raw)


def _members(value: Any) -> dict[str, Any]:
    return value if isinstance(value, dict) else vars(value)


def _field(value: Any, path: str) -> Any:
    for name in path.split("."):
        there = _members(value)
        if name not in there:
            raise Refusal("no such field", f"{name!r} among {', '.join(map(str, there))}"[:200])
        value = there[name]
    return value


def _xyz(value: Any) -> tuple[float, float, float]:
    if isinstance(value, list | tuple) or hasattr(value, "tolist"):
        x, y, *z = (float(number) for number in value)
        return x, y, sum(z[:1])
    return float(_field(value, "x")), float(_field(value, "y")), float(_members(value).get("z", 0.0))
