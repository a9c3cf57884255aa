"""Class names of the map for those of the detections, by the settings under [labels]."""

from dataclasses import replace
from fnmatch import fnmatchcase

from logs.messages import ObjectDetections
from slam.common.config import LabelsConfig
from slam.common.errors import ConfigurationError

DROPPED = ""
"""Label of a detection that is left out; no detection of a log has it."""


class LabelMap:
    """Renames and drops classes; names that differ in case only are one class, spelled as it was seen first.

    The number of detections stays, so that each keeps its place in its message.

    Raises:
        ConfigurationError: one name is renamed and dropped.
    """

    def __init__(self, config: LabelsConfig) -> None:
        for name in config.drop:
            if name in config.rename:
                raise ConfigurationError(f"labels: {name!r} is both in drop and in rename")
        self._rules = {**dict.fromkeys(config.drop, DROPPED), **config.rename}
        self._known: dict[str, str] = {}
        self._used: set[str] = set()
        self._spellings: dict[str, str] = {}

    def apply(self, detections: ObjectDetections) -> ObjectDetections:
        """The detections under their names in the map, ``DROPPED`` for those that are left out."""
        names = tuple(self.name(label) for label in detections.labels)
        return detections if names == detections.labels else replace(detections, labels=names)

    def notes(self) -> list[str]:
        """What a user should know: settings that named no class so far, and classes that are spelled in two ways."""
        unused = [
            f"labels.{'drop' if target == DROPPED else 'rename'}: {name}: no detection has this class"
            for name, target in self._rules.items()
            if name not in self._used
        ]
        respelled = [
            f"class {name} is read as {to}: they differ in case only"
            for name, to in self._known.items()
            if name != to and name.casefold() == to.casefold()
        ]
        return unused + respelled

    def name(self, label: str) -> str:
        """The name of a class in the map, ``DROPPED`` if it is left out."""
        name = self._known.get(label)
        if name is None:
            name = label
            for pattern, target in self._rules.items():
                if fnmatchcase(label, pattern):
                    self._used.add(pattern)
                    name = target
                    break
            name = self._known[label] = self._spellings.setdefault(name.casefold(), name)
        return name
