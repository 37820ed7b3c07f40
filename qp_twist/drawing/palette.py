"""The palette of all figures, pages and scenes, and the style of figures."""

from __future__ import annotations

from typing import Any

# Okabe and Ito's colours, distinguishable with all common kinds of colour vision. Blue for the
# twist decomposition and orange for resolved motion rate are the paper's own.
BLUE, ORANGE, GREEN, PINK, BLACK = "#0072B2", "#E69F00", "#009E73", "#CC79A7", "#000000"
RED = "#D00000"
"""Limits, and what does not pass."""
GRID, FAINT, INK, QUIET = "#DDDDDD", "#9FB4C4", "#1B1F24", "#57606A"
"""Grids and shaded stretches; lines beside the one that counts; text, and text beside it."""

RC: Any = {
    "text.color": INK, "axes.labelcolor": INK, "xtick.color": INK, "ytick.color": INK,
    "font.size": 9,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.grid": True,
    "grid.color": GRID,
    "grid.linewidth": 0.5,
    "axes.titlesize": 9,
    "axes.titlelocation": "left",
    "figure.dpi": 100,
    "savefig.dpi": 160,
    "legend.frameon": False,
}  # fmt: skip
"""Matplotlib's settings of a figure."""


def rgb(colour: str) -> tuple[int, int, int]:
    """A colour of the palette as it is given to scenes, 0 to 255."""
    red, green, blue = bytes.fromhex(colour.removeprefix("#"))
    return red, green, blue
