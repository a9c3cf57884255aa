"""What a prior map says of the variables of the graph: constants, and landmarks that may still enter it."""

from __future__ import annotations

from collections.abc import Mapping

from slam.backend.factors import LandmarkPrior
from slam.common.arrays import FloatArray


class KnownMap:
    """Keyframes that never move, and landmarks that enter the graph when something is merged into them.

    ``frame``: the keyframe that stands for the frame of a map without keyframes; None where there is none.
    """

    def __init__(self) -> None:
        self._poses: dict[int, FloatArray] = {}
        self._positions: dict[int, tuple[FloatArray, FloatArray]] = {}  # with standard deviations
        self._fixed_landmarks: set[int] = set()
        self.frame: int | None = None

    def add_keyframe(self, keyframe: int, T_map_body: FloatArray) -> None:
        """Take in a keyframe that never moves, with its pose (4, 4)."""
        self._poses[keyframe] = T_map_body

    def add_landmarks(self, positions: Mapping[int, FloatArray], sigmas_m: FloatArray, *, is_fixed: bool) -> None:
        """Take in landmarks: (3,) m by id, with standard deviations (3,) of the coordinates."""
        self._positions.update((landmark, (position, sigmas_m)) for landmark, position in positions.items())
        if is_fixed:
            self._fixed_landmarks.update(positions)

    @property
    def poses(self) -> Mapping[int, FloatArray]:
        """``T_map_body`` (4, 4) of the keyframes that never move."""
        return self._poses

    @property
    def fixed_landmarks(self) -> set[int]:
        """Landmarks that are constants."""
        return self._fixed_landmarks

    def holds(self, landmark: int) -> bool:
        """Whether a landmark is of this map."""
        return landmark in self._positions

    def prior_of(self, landmark: int) -> LandmarkPrior:
        """The prior by which a landmark of this map enters the graph."""
        position, sigmas_m = self._positions[landmark]
        return LandmarkPrior(landmark, position, sigmas_m)
