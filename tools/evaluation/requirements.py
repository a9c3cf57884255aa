"""--require: conditions on the figures of runs."""

import sys
from collections.abc import Mapping, Sequence
from typing import Annotated, Any

import typer


def _checked(texts: list[str] | None) -> list[str] | None:
    """The same texts; a malformed one is refused before any work is done."""
    if texts:
        from slam.evaluation.requirements import parse_requirement

        for text in texts:
            parse_requirement(text)
    return texts


Require = Annotated[
    list[str] | None,
    typer.Option(
        metavar="KEY<=NUMBER",
        help="Exit with 1 unless this condition (<= >= == < >) holds for every run. Repeatable.",
        callback=_checked,
    ),
]


def finish(
    runs: Mapping[str, Mapping[str, Any]],
    requirements: Sequence[str] | None,
    *,
    quiet: bool = False,
    failures: Sequence[str] = (),
) -> None:
    """Print which requirements each of the ``runs``, by name, meets, unless ``quiet``, and which it does not.

    Raises:
        Exit: with code 1, a requirement is not met, or there are failures.
    """
    from slam.evaluation.requirements import check_requirement
    from tools import console

    unmet = []
    for name, results in runs.items():
        run = f"{name}: " if name else ""
        for requirement in requirements or ():
            is_met, text = check_requirement(requirement, results)
            if not is_met:
                unmet.append(run + text)
            elif not quiet:
                console.show(f"met: {run}{text}")
    lines = [f"{what}: {'; '.join(texts)}" for what, texts in (("failed", failures), ("not met", unmet)) if texts]
    if lines:
        sys.stdout.flush()
        print(f"dslam: {' '.join('; '.join(lines).split())}", file=sys.stderr)
        raise typer.Exit(1)
