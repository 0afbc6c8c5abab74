"""How methods and tools look in figures: the same colour and marker everywhere.

The colours are those of Okabe and Ito, which colour-blind readers tell apart.
"""

from typing import Any

LOOKS = {
    "background": ("background", "0.6", "_"),
    "eofm": ("eofm (test 5)", "#0072B2", "o"),
    "test5": ("test 5", "#0072B2", "o"),
    "eofm preset": ("eofm preset", "#D55E00", "s"),
    "preset_free": ("preset, images only", "#F0E442", "s"),
    "preset": ("preset", "#D55E00", "s"),
    "test6": ("test 6", "#000000", "*"),
    "tvl1": ("TV-L1", "#CC79A7", "v"),
    "ilk": ("ILK", "#F0E442", "<"),
    "dis": ("DIS", "#009E73", "^"),
    "deepflow": ("DeepFlow", "#999999", "P"),
    "elastix": ("elastix", "#56B4E9", "D"),
    "demons": ("demons", "#E69F00", "X"),
    "pyxel": ("pyxel", "#000000", "p"),
}


def look(name: str) -> dict[str, Any]:
    """Label, colour and marker of a method or tool, for Axes.plot."""
    label, colour, marker = LOOKS[name]
    edge = {"markeredgecolor": "black", "markeredgewidth": 0.4}
    return {"label": label, "color": colour, "marker": marker, "markersize": 5} | (
        {} if marker == "_" else edge
    )
