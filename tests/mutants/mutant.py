"""Mutants of the estimator's sources, made by the operators of cosmic-ray."""

import ast
import random
import re
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

from cosmic_ray.ast import ast_nodes, get_ast_from_path
from cosmic_ray.mutating import mutate_code
from cosmic_ray.plugins import get_operator, operator_names

ROOT = Path(__file__).parents[2]
FOLDERS = ("frontend", "localization", "loop_closure", "registration", "odometry", "self_calibration")
"""Below slam/."""
LEFT_OUT = re.compile(
    "RemoveDecorator|Binary.*_(BitAnd|BitOr|BitXor|LShift|RShift|Mod|FloorDiv|Pow)$|(LtE_Lt|Lt_LtE|GtE_Gt|Gt_GtE)$"
)
"""Operators whose mutants cannot be imported, raise an error at the first call, or differ only for equal numbers."""


@dataclass(frozen=True)
class Mutant:
    """``file``, relative to the repository, with an operator of cosmic-ray applied at its ``occurrence``-th place."""

    file: str
    operator: str
    occurrence: int

    @property
    def name(self) -> str:
        return f"{self.file}: {self.operator.removeprefix('core/')} {self.occurrence}"

    @property
    def tests(self) -> tuple[str, ...]:
        """The test file of the module first, then all of its folder."""
        path = Path("tests") / self.file
        candidates = (path.with_name(f"test_{path.name}"), path.parent)
        return tuple(str(each) for each in candidates if (ROOT / each).exists())

    @property
    def original(self) -> str:
        return (ROOT / self.file).read_text(encoding="utf-8")

    def source(self) -> str:
        """The text of the file with the change."""
        changed = mutate_code(self.original, get_operator(self.operator)(), self.occurrence)
        return str(changed or self.original)

    @property
    def is_equivalent(self) -> bool:
        """Whether it changes nothing but annotations, docstrings or layout, or is no Python, as ``a & not b``."""
        try:
            return _meaning(self.source()) == _meaning(self.original)
        except SyntaxError:
            return True


def sample_mutants(count: int, *, seed: int) -> list[Mutant]:
    """``count`` different mutants of all that are possible, in a random order: first a file, then a place in it."""
    rng = random.Random(seed)
    places = {file: list(_places(file)) for folder in FOLDERS for file in _sources(folder)}
    weights = [len(each) for each in places.values()]
    found: dict[Mutant, None] = {}
    for _ in range(100 * count):
        if len(found) == count:
            break
        (file,) = rng.choices(list(places), weights)
        mutant = Mutant(file, *rng.choice(places[file]))
        if mutant not in found and not mutant.is_equivalent:
            found[mutant] = None
    return list(found)


def _sources(folder: str) -> Iterator[str]:
    for path in sorted((ROOT / "slam" / folder).rglob("*.py")):
        if path.name != "__init__.py":
            yield path.relative_to(ROOT).as_posix()


def _places(file: str) -> Iterator[tuple[str, int]]:
    """Operator and occurrence of each possible change."""
    nodes = list(ast_nodes(get_ast_from_path(ROOT / file)))
    for name in operator_names():
        operator = get_operator(name)
        if not operator.arguments() and not LEFT_OUT.search(name):
            count = sum(1 for node in nodes for _ in operator().mutation_positions(node))
            yield from ((name, occurrence) for occurrence in range(count))


def _meaning(text: str) -> str:
    """The syntax tree without what does not run."""
    tree = ast.parse(text)
    for node in ast.walk(tree):
        if isinstance(node, ast.arg | ast.AnnAssign):
            node.annotation = ast.Constant(None)
        elif isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef):
            node.returns = None
    return ast.dump(tree)
