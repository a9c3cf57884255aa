"""A player of logs that holds what Foxglove shows: entities by id, the last cloud of each topic, frames by child."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path
from typing import Any

import numpy as np
from foxglove_schemas_protobuf.FrameTransforms_pb2 import FrameTransforms
from foxglove_schemas_protobuf.Log_pb2 import Log
from foxglove_schemas_protobuf.PointCloud_pb2 import PointCloud
from foxglove_schemas_protobuf.SceneEntityDeletion_pb2 import SceneEntityDeletion
from foxglove_schemas_protobuf.SceneUpdate_pb2 import SceneUpdate

from logs.reader import LogReader
from logs.topics import RawMessage


class Player:
    def __init__(self) -> None:
        self.entities: dict[str, dict[str, Any]] = {}
        self.clouds: dict[str, np.ndarray] = {}
        self.parents: dict[str, str] = {}
        self.transforms: dict[str, np.ndarray] = {}
        self.texts: list[str] = []

    @classmethod
    def played(cls, path: Path, until_ns: int) -> Player:
        """From the beginning of a log."""
        return cls()._hold(raw for raw in _messages(path) if raw.log_time_ns <= until_ns)

    @classmethod
    def after_seek(cls, path: Path, to_ns: int) -> Player:
        """Right after a jump: Foxglove has the last message of each topic then."""
        last = {raw.topic: raw for raw in _messages(path) if raw.log_time_ns <= to_ns}
        return cls()._hold(last.values())

    def positions(self, topic: str) -> dict[str, np.ndarray]:
        """Where the objects on a topic of entities stand."""
        found = {}
        for name, entity in self.entities.get(topic, {}).items():
            shapes: list[Any] = [*entity.cubes, *entity.spheres, *entity.cylinders]
            (shape,) = shapes
            found[name] = np.array([shape.pose.position.x, shape.pose.position.y, shape.pose.position.z])
        return found

    def _hold(self, messages: Iterable[RawMessage]) -> Player:
        for raw in messages:
            match raw.channel.schema_name:
                case "foxglove.SceneUpdate":
                    self._update(self.entities.setdefault(raw.topic, {}), SceneUpdate.FromString(raw.data))
                case "foxglove.PointCloud":
                    self.clouds[raw.topic] = _points(PointCloud.FromString(raw.data))
                case "foxglove.FrameTransforms":
                    for each in FrameTransforms.FromString(raw.data).transforms:
                        self.parents[each.child_frame_id] = each.parent_frame_id
                        t = each.translation
                        self.transforms[each.child_frame_id] = np.array([t.x, t.y, t.z])
                case "foxglove.Log":
                    self.texts.append(Log.FromString(raw.data).message)
        return self

    @staticmethod
    def _update(entities: dict[str, object], update: SceneUpdate) -> None:
        for deletion in update.deletions:
            if deletion.type == SceneEntityDeletion.ALL:
                entities.clear()
            else:
                entities.pop(deletion.id, None)
        for entity in update.entities:
            assert entity.lifetime.ToNanoseconds() == 0
            entities[entity.id] = entity


def _messages(path: Path) -> list[RawMessage]:
    with LogReader(path) as reader:
        return list(reader.messages())


def _points(cloud: PointCloud) -> np.ndarray:
    kinds = {field.name: "<f4" if field.type == field.FLOAT32 else "u1" for field in cloud.fields}
    layout = np.dtype(
        {
            "names": list(kinds),
            "formats": list(kinds.values()),
            "offsets": [field.offset for field in cloud.fields],
            "itemsize": cloud.point_stride,
        }
    )
    rows = np.frombuffer(cloud.data, dtype=layout)
    return np.stack([rows[axis] for axis in "xyz"], axis=1).astype(np.float64)
