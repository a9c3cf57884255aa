"""Detections in messages of any schema, by the names of their fields: "plants[] position=position label=kind".

Before the first blank stands the field with the list of objects (nothing, for a message that is one object), then for
each part of a detection the field that holds it: ``position`` (x, y and z in it, or three numbers), or ``x``, ``y`` and
``z``; and perhaps ``label`` and ``score``. A field in a field is "a.b". Stamp and frame are those of the field
``header``, as ROS has it, else the log time and the body.
"""

import json
from collections.abc import Mapping
from types import SimpleNamespace
from typing import Any

from logs.decoders.parts import Context, Detection, Records, detection_records, place_of
from logs.errors import TopicSelectionError
from logs.records import frozen
from logs.topics import RawMessage
from logs.validation import Refusal

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
        is_placed = getattr(message, "header", None) is not None
        place = place_of(message, context) if is_placed else (context.raw.log_time_ns, "")
        return detection_records({place: found}, context.counters)

    def _detection(self, item: Any) -> Detection:
        parts = {part: _field(item, path) for part, path in self.fields.items()}
        position = _xyz(parts.get("position", SimpleNamespace(**parts)))
        return Detection(position, str(parts.get("label", "")), float(parts.get("score", 1.0)))


def _tree(raw: RawMessage) -> Any:
    if raw.channel.message_encoding == "json":
        return json.loads(raw.data, object_hook=lambda members: SimpleNamespace(**members))
    if raw.channel.message_encoding != "cdr":
        raise Refusal("fields are mapped in JSON and ROS messages", f"encoding {raw.channel.message_encoding!r}")
    from logs.decoders.cdr import parse  # loads rosbags

    return parse(raw)


def _field(value: Any, path: str) -> Any:
    for name in path.split("."):
        there = vars(value)
        if name not in there:
            raise Refusal("no such field", f"{name!r} among {', '.join(map(str, there))}"[:200])
        value = there[name]
    return value


def _xyz(value: Any) -> tuple[float, float, float]:
    if isinstance(value, list | tuple) or hasattr(value, "tolist"):
        x, y, *z = (float(number) for number in value)
        return x, y, sum(z[:1])
    return float(_field(value, "x")), float(_field(value, "y")), float(getattr(value, "z", 0.0))
