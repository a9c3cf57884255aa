"""Class names of the map for those of the detections, by the settings under [labels]."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from fnmatch import fnmatchcase

from logs.messages import ObjectDetections
from slam.common.config import LabelsConfig
from slam.common.errors import ConfigurationError

DROPPED = ""
"""Label of a detection that is left out; no detection of a log has it."""


class LabelMap:
    """Renames, merges and drops classes; names that differ in case only are one class, spelled as it was seen first.

    The number of detections stays, so that each keeps its place in its message.

    Raises:
        ConfigurationError: one name stands in two of the settings.
    """

    def __init__(self, config: LabelsConfig) -> None:
        self._rules = list(_rules(config))
        names = [pattern for _, pattern, _ in self._rules]
        for name in names:
            if names.count(name) > 1:
                raise ConfigurationError(f"labels: {name!r} is in more than one of drop, rename and merge")
        self._known: dict[str, str] = {}
        self._used: set[str] = set()
        self._spellings: dict[str, str] = {}

    def apply(self, detections: ObjectDetections) -> ObjectDetections:
        """The detections under their names in the map, ``DROPPED`` for those that are left out."""
        names = tuple(self.name(label) for label in detections.labels)
        return detections if names == detections.labels else replace(detections, labels=names)

    def unused(self) -> list[str]:
        """The settings that named no class so far, "labels.drop: cars" each."""
        return [f"labels.{setting}: {name}" for setting, name, _ in self._rules if name not in self._used]

    def name(self, label: str) -> str:
        """The name of a class in the map, ``DROPPED`` if it is left out."""
        name = self._known.get(label)
        if name is None:
            name = label
            for _, pattern, target in self._rules:
                if fnmatchcase(label, pattern):
                    self._used.add(pattern)
                    name = target
                    break
            name = self._known[label] = self._spellings.setdefault(name.casefold(), name)
        return name

    def respelled(self) -> dict[str, str]:
        """Names so far that differ from the spelling seen first in case only, with that spelling."""
        return {name: to for name, to in self._known.items() if name != to and name.casefold() == to.casefold()}


def _rules(config: LabelsConfig) -> Iterator[tuple[str, str, str]]:
    """Setting, pattern of old names, new name."""
    yield from (("drop", pattern, DROPPED) for pattern in config.drop)
    yield from (("rename", pattern, target) for pattern, target in config.rename.items())
    yield from (("merge", pattern, target) for target, patterns in config.merge.items() for pattern in patterns)
