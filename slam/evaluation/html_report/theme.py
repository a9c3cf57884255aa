"""The colours of the page, for light and for dark surroundings; paths and closures as in all pictures."""

from __future__ import annotations

from slam.visualization import palette

STAGES = {
    "repeated": "--stage-repeated",
    "retrieval": "--stage-retrieval",
    "registration": "--stage-registration",
    "acceptance": "--stage-acceptance",
    "consistency": "--stage-consistency",
    "association": "--stage-association",
    "back_end": "--stage-back-end",
    "accepted": "--closure-true",
}
"""Stage of a decision -> colour."""

LIGHT = {
    "--ink": "#1f2937",
    "--muted": "#566072",
    "--page": "#f6f7f9",
    "--surface": "#ffffff",
    "--line": "#dfe3e8",
    "--grid": "#e9ecf0",
    "--link": palette.ESTIMATE,
    "--estimate": palette.ESTIMATE,
    "--odometry": palette.ODOMETRY,
    "--truth": palette.TRUTH,
    "--online": "#64748b",
    "--start": palette.START,
    "--end": palette.END,
    "--closure-true": palette.TRUE_CLOSURE,
    "--closure-false": palette.FALSE_CLOSURE,
    "--closure-undecided": palette.CLOSURE,
    "--missed": palette.MISSED,
    "--stage-repeated": "#d5dae1",
    "--stage-retrieval": "#b6bdc8",
    "--stage-registration": "#7d9cc0",
    "--stage-acceptance": "#c9a50a",
    "--stage-consistency": "#e377c2",
    "--stage-association": "#8c6bb1",
    "--stage-back-end": "#d64545",
    "--other": palette.OTHER_COLOR,
    "--landmarks": "#8456c4",
    "--lost": palette.LOST,
    "--found": palette.FOUND,
}

# Lighter where the colour of the picture, which is white, would drown in the dark.
DARK = LIGHT | {
    "--ink": "#e6e9ee",
    "--muted": "#a2abb8",
    "--page": "#12161c",
    "--surface": "#1a2028",
    "--line": "#323b47",
    "--grid": "#2a323d",
    "--link": "#6cb1ff",
    "--estimate": "#4c9df0",
    "--odometry": "#f0a13a",
    "--truth": "#e6e9ee",
    "--online": "#94a3b8",
    "--start": "#34c76a",
    "--end": "#f0605f",
    "--closure-true": "#2dd4bf",
    "--closure-false": "#ff4d4d",
    "--closure-undecided": "#f062c0",
    "--missed": "#b794ff",
    "--stage-repeated": "#414a57",
    "--stage-retrieval": "#5b6675",
    "--stage-registration": "#7d9cc0",
    "--stage-association": "#b794ff",
    "--landmarks": "#ab82e6",
    "--lost": "#f87171",
    "--found": "#4ade80",
}


def style_properties() -> str:
    """The colours as CSS custom properties."""
    light, dark = (
        "\n".join(f"  {name}: {color};" for name, color in colors.items())
        for colors in (LIGHT, {name: color for name, color in DARK.items() if color != LIGHT[name]})
    )
    return (
        f":root {{\n  color-scheme: light dark;\n{light}\n}}\n"
        f"@media (prefers-color-scheme: dark) {{\n:root {{\n{dark}\n}}\n}}\n"
    )
