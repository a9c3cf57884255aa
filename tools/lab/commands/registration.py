"""dslam benchmark registration."""

from __future__ import annotations

from typing import Annotated

import typer

from tools.arguments import Json
from tools.lab.tables import number, percent, show


def registration(
    seed: Annotated[int, typer.Option(min=0, help="Seed of the problems.")] = 0,
    trials: Annotated[int, typer.Option(min=1, help="Problems of each kind; a quarter of them for 5000.")] = 20,
    json: Json = False,
) -> None:
    """Register constellations from correspondences most of which are false, beside Open3D and KISS-Matcher.

    Example: dslam benchmark registration --trials 5
    """
    from dataclasses import asdict

    from tools import console
    from tools.lab.descriptors.registration import benchmark_registration

    result = benchmark_registration(seed=seed, trials=trials)
    if json:
        console.show_json(asdict(result))
        return
    rows = [
        {
            "method": c.method,
            "pairs": str(c.correspondences),
            "false": percent(c.false_share, 0),
            "true": str(c.true_correspondences),
            "success %": percent(c.success, 0),
            "error m": number(c.median_error_m, 2),
            "deg": number(c.median_error_deg, 2),
            "ms": number(c.median_ms, 2),
            "fastest": number(c.fastest_ms, 2),
        }
        for c in result.cells
    ]
    unavailable = [f"{name}: not measured, {why}" for name, why in result.unavailable.items()]
    show(rows, *unavailable, "Fewer than 3 true correspondences determine nothing that chance does not.")
