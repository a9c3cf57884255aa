"""The map as topics for viewers, kept up to date by what has changed since the last message."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from logs.messages import Record, SceneLines, SceneMarkers, ScenePoints
from logs.scene import class_color
from slam.common.arrays import FloatArray, IntArray
from slam.display.snapshot import MapSnapshot

MAP_FRAME = "map"
LANDMARKS, LANDMARK_POINTS, SUBMAP = "/slam/landmarks", "/slam/landmark_points", "/slam/submap"
PATH, CLOSURES = "/slam/path", "/slam/closure_lines"
PATH_COLOR = (0.15, 0.45, 1.0, 1.0)
CLOSURE_COLOR = (0.84, 0.15, 0.79, 0.9)
SUBMAP_COLOR = (1.0, 1.0, 1.0, 1.0)
INTERVAL_NS = 5_000_000_000
"""The whole of a small map is written again when so much time has passed."""
SMALL_MAP = 5_000
"""Points up to which a map is small. A larger one is written more seldom, so that a log grows with the drive and not
with its square."""
TOLERANCE_RANGES = 1.0 / 3000.0
"""What has moved by less, in sensor ranges, stays where viewers have it."""

Message = tuple[str, Record]
"""Topic and record."""


class MapTopics:
    """Turns snapshots of the map into messages.

    ``/slam/landmarks`` gets only what is new, has moved, or was retired or merged. The last message of each other topic
    holds all of it, so that a viewer that begins anywhere in a log has the whole map.
    """

    def __init__(self, sensor_range_m: float) -> None:
        self._tolerance_m = TOLERANCE_RANGES * sensor_range_m
        self._positions = np.zeros((0, 3))  # of the landmarks that are shown, by id; NaN for all others
        self._labels: dict[int, str] = {}
        self._path = np.zeros((0, 3))
        self._written_positions = self._positions
        self._written_ns: int | None = None

    def update(self, snapshot: MapSnapshot, *, is_closed: bool = False, is_final: bool = False) -> list[Message]:
        """What viewers must be told: the whole map if a loop ``is_closed``; all that was told anew if ``is_final``."""
        if is_final:
            self._positions = np.full_like(self._positions, np.nan)
        removed = np.setdiff1d(np.flatnonzero(np.isfinite(self._positions[:, 0])), snapshot.landmarks)
        changed = self._take_over(snapshot)
        self._positions[removed] = np.nan
        messages: list[Message] = []
        if len(changed) or len(removed) or is_final:
            messages.append((LANDMARKS, self._markers(snapshot.stamp_ns, changed, removed, replaces=is_final)))
        messages.append(self._submap(snapshot))
        if is_final or self._is_due(snapshot, is_closed=is_closed):
            messages += [self._landmark_points(snapshot.stamp_ns), *self._path_and_closures(snapshot)]
        elif not self._are_points_right():
            messages.append(self._landmark_points(snapshot.stamp_ns))
        return messages

    def _is_due(self, snapshot: MapSnapshot, *, is_closed: bool) -> bool:
        """Whether the whole map is to be written: after an interval that grows with it; sooner after a closure."""
        if self._written_ns is None:
            return True
        points = len(snapshot.landmarks) + len(self._path) + len(snapshot.closures)
        interval_ns = INTERVAL_NS * max(points / SMALL_MAP, 1.0) - is_closed * INTERVAL_NS
        return snapshot.stamp_ns - self._written_ns >= interval_ns

    def _take_over(self, snapshot: MapSnapshot) -> IntArray:
        """Note where the landmarks are now; returns those (N,) that are not as they were shown."""
        ids = snapshot.landmarks
        missing = int(ids.max(initial=-1)) + 1 - len(self._positions)
        if missing > 0:
            self._positions = np.vstack([self._positions, np.full((missing, 3), np.nan)])
        is_same = _are_near(self._positions[ids], snapshot.positions, self._tolerance_m)
        is_same &= np.array(
            [self._labels.get(i) == name for i, name in zip(ids.tolist(), snapshot.labels, strict=True)], dtype=np.bool_
        )
        changed = np.flatnonzero(~is_same)
        self._positions[ids[changed]] = snapshot.positions[changed]
        self._labels.update((int(ids[row]), snapshot.labels[row]) for row in changed)
        return ids[changed]

    def _are_points_right(self) -> bool:
        """Whether all that stands in the last cloud of landmarks is still there."""
        written = np.flatnonzero(np.isfinite(self._written_positions[:, 0]))
        is_right = _are_near(self._positions[written], self._written_positions[written], 2.0 * self._tolerance_m)
        return bool(is_right.all())

    def _landmark_points(self, stamp_ns: int) -> Message:
        self._written_positions = self._positions.copy()
        shown = np.flatnonzero(np.isfinite(self._positions[:, 0]))
        colors = np.array([class_color(self._labels[each]) for each in shown.tolist()]).reshape(-1, 4)
        return LANDMARK_POINTS, ScenePoints(stamp_ns, MAP_FRAME, self._positions[shown], colors)

    def _path_and_closures(self, snapshot: MapSnapshot) -> list[Message]:
        self._written_ns = snapshot.stamp_ns
        path = np.concatenate([*snapshot.path, np.zeros((0, 3))])
        known = path[: len(self._path)]
        path[: len(self._path)] = np.where(
            _are_near(self._path[: len(known)], known, self._tolerance_m)[:, None], self._path[: len(known)], known
        )
        self._path = path
        polylines = tuple(np.split(path, np.cumsum([len(part) for part in snapshot.path])[:-1]))
        return [
            (PATH, SceneLines(snapshot.stamp_ns, MAP_FRAME, polylines, PATH_COLOR)),
            (CLOSURES, SceneLines(snapshot.stamp_ns, MAP_FRAME, tuple(snapshot.closures), CLOSURE_COLOR)),
        ]

    def _markers(self, stamp_ns: int, changed: IntArray, removed: IntArray, *, replaces: bool) -> SceneMarkers:
        return SceneMarkers(
            stamp_ns=stamp_ns,
            frame_id=MAP_FRAME,
            positions=self._positions[changed],
            labels=tuple(self._labels[int(i)] for i in changed),
            ids=tuple(str(i) for i in changed),
            removed=tuple(str(i) for i in removed),
            replaces=replaces,
        )

    def _submap(self, snapshot: MapSnapshot) -> Message:
        positions = self._positions[snapshot.submap]
        return SUBMAP, ScenePoints(snapshot.stamp_ns, MAP_FRAME, positions, np.tile(SUBMAP_COLOR, (len(positions), 1)))


def _are_near(first: FloatArray, second: FloatArray, tolerance_m: float) -> NDArray[np.bool_]:
    """Which of the positions (N, 3) are the same to within the tolerance; a NaN is not."""
    return np.asarray(np.linalg.norm(first - second, axis=1) <= tolerance_m)
