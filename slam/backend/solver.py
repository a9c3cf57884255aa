"""The common part of incremental and batch solver: factors by their numbers, and the variables in use."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections import Counter
from collections.abc import Mapping

import gtsam
import numpy as np
from gtsam.symbol_shorthand import X

from slam.common.arrays import FloatArray
from slam.common.errors import FactorGraphError

Value = gtsam.Pose3 | FloatArray
"""The pose of a keyframe, or the position (3,) m of a landmark."""


class Solver(ABC):
    """Factors of GTSAM by the caller's numbers, and the values of the variables that they tie together.

    Variables are named by GTSAM's keys. A landmark leaves with its last factor.
    """

    def __init__(self) -> None:
        self._factors: dict[int, gtsam.NonlinearFactor] = {}
        self._uses: Counter[int] = Counter()
        self._added: dict[int, gtsam.NonlinearFactor] = {}  # since the last update
        self._removed: list[int] = []  # of those that were there at the last update

    @property
    def factors(self) -> Mapping[int, gtsam.NonlinearFactor]:
        """All factors, by their numbers."""
        return self._factors

    def add(self, number: int, factor: gtsam.NonlinearFactor) -> None:
        """Add a factor between variables that are held."""
        self._factors[number] = self._added[number] = factor
        self._uses.update(factor.keys())

    def remove(self, number: int) -> None:
        """Remove a factor; a landmark leaves with its last one."""
        factor = self._factors.pop(number)
        if self._added.pop(number, None) is None:
            self._removed.append(number)
        for key in factor.keys():  # noqa: SIM118 - a GTSAM factor is not a mapping
            self._uses[key] -= 1
            if not self._uses[key] and gtsam.symbolChr(key) == ord("l"):
                self._release(key)

    def restart(self, values: gtsam.Values, factors: Mapping[int, gtsam.NonlinearFactor]) -> None:
        """Solve these factors, and no others, from ``values``."""
        self._factors, self._added, self._removed, self._uses = {}, {}, [], Counter()
        for number, factor in factors.items():
            self.add(number, factor)
        self._start(values)
        self._note_update()

    def update(self) -> None:
        """Bring the estimate up to date with all that was added and removed."""
        if self._added or self._removed:
            self._improve()
            self._note_update()

    def _note_update(self) -> None:
        self._added, self._removed = {}, []

    def pose(self, keyframe: int) -> FloatArray:
        """``T_map_body`` (4, 4) of a keyframe."""
        if not self.holds(X(keyframe)):
            raise FactorGraphError(f"keyframe {keyframe} is not in the graph")
        return np.asarray(self._pose(keyframe).matrix())

    @abstractmethod
    def holds(self, key: int) -> bool:
        """Whether the solver holds a variable."""

    @abstractmethod
    def insert(self, key: int, value: Value) -> None:
        """Add a variable with its initial value."""

    @abstractmethod
    def values(self) -> gtsam.Values:
        """The estimate of all variables, as of the last update."""

    @abstractmethod
    def _start(self, values: gtsam.Values) -> None:
        """Solve all factors, from ``values``."""

    @abstractmethod
    def _improve(self) -> None:
        """Improve the estimate by what was added and removed."""

    @abstractmethod
    def _release(self, key: int) -> None: ...

    @abstractmethod
    def _pose(self, keyframe: int) -> gtsam.Pose3: ...
