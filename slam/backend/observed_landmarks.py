"""Which landmarks are in the graph: their observations, and the variables that merged landmarks share."""

from __future__ import annotations

from collections.abc import Iterator

from slam.common.union_find import Merge, UnionFind


class ObservedLandmarks:
    """Landmarks by their ids, with the numbers of the factors that observe them.

    A landmark that was merged into another one shares its variable, which has that one's id.
    """

    def __init__(self) -> None:
        self._factors: dict[int, list[int]] = {}  # by the landmark that was seen
        self._members: dict[int, list[int]] = {}  # landmarks in the graph by the variable that they share
        self._merges = UnionFind()

    @property
    def variables(self) -> set[int]:
        """Ids of the landmarks that have a variable of their own."""
        return set(self._members)

    def __contains__(self, landmark: int) -> bool:
        """Whether a landmark is observed."""
        return landmark in self._factors

    def variable_of(self, landmark: int) -> int:
        """The landmark that stands for this one."""
        return self._merges.find(landmark) if self._merges.is_dropped(landmark) else landmark

    def factors_of_variables(self) -> Iterator[tuple[int, list[int]]]:
        """Each variable with the factors that observe it."""
        for variable, landmarks in self._members.items():
            yield variable, [number for landmark in landmarks for number in self._factors[landmark]]

    def with_absorbed(self, landmark: int) -> list[int]:
        """A landmark, and all that were merged into it."""
        return [landmark, *self._merges.absorbed(landmark)]

    def factors_of(self, landmark: int) -> list[int]:
        """The factors that observe a landmark and those merged into it."""
        return [number for each in self.with_absorbed(landmark) for number in self._factors.get(each, ())]

    def enter(self, landmark: int) -> bool:
        """Take in a landmark that is not in the graph; returns whether it needs a variable."""
        self._factors[landmark] = []
        variable = self.variable_of(landmark)
        is_new = variable not in self._members
        self._members.setdefault(variable, []).append(landmark)
        return is_new

    def observe(self, landmark: int, factor: int) -> None:
        """Note that a factor observes a landmark."""
        self._factors[landmark].append(factor)

    def forget(self, landmark: int, factor: int) -> int | None:
        """A factor observes a landmark no longer; returns the variable that nothing observes now, or None."""
        remaining = self._factors[landmark]
        remaining.remove(factor)
        if remaining:
            return None
        del self._factors[landmark]
        variable = self.variable_of(landmark)
        self._members[variable].remove(landmark)
        if self._members[variable]:
            return None
        del self._members[variable]
        return variable

    def are_one(self, first: int, second: int) -> bool:
        """Whether two landmarks are merged."""
        return self._merges.find(first) == self._merges.find(second)

    def merge(self, kept: int, dropped: int) -> None:
        """Let one landmark stand for another one, which must not be observed, and for what that stands for."""
        self._merges.merge(kept, dropped)

    @property
    def last_merge(self) -> Merge | None:
        """The last merge in force."""
        return self._merges.history[-1] if self._merges else None

    def undo(self, merge: Merge) -> None:
        """Undo the last merge in force."""
        self._merges.undo(merge)
