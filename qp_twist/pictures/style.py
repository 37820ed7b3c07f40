"""Colours and lines of the figures: one colour per QP, solid; its closed forms dashed."""

from __future__ import annotations

from collections.abc import Iterable
from typing import TYPE_CHECKING, Any

from qp_twist.paths import METHODS

if TYPE_CHECKING:
    from matplotlib.lines import Line2D

# Okabe and Ito's palette, distinguishable with all common kinds of colour vision. Blue for the
# twist decomposition and orange for resolved motion rate are the paper's own.
_PAIR_COLOURS = {
    "qp_rmr": "#E69F00",
    "qp_minimum_norm": "#009E73",
    "qp_gradient": "#CC79A7",
    "qp": "#0072B2",
    "qp_planned": "#000000",
}
# Used in turn for the closed forms and peers of one QP.
_DASHES: tuple[Any, ...] = (
    (0, (4, 2)), (0, (1, 1.5)), (0, (6, 1.5, 1, 1.5)),
    (0, (2, 1)), (0, (8, 2)), (0, (4, 1, 1, 1, 1, 1)),
)  # fmt: skip
LIMIT = "#D00000"
GRID = "#DDDDDD"

RC: Any = {
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
}


def pair_of(name: str) -> str:
    """The QP of a method's pair."""
    method = METHODS[name]
    return name if method.constrained or method.counterpart is None else method.counterpart


def line_style(name: str) -> dict[str, Any]:
    """Matplotlib keywords of a method's curve."""
    from matplotlib.colors import to_rgb

    method = METHODS[name]
    colour = to_rgb(_PAIR_COLOURS[pair_of(name)])
    if method.constrained:
        dashes: Any = "solid"
    else:
        # Darker, so that dashes show on top of their counterpart's line.
        red, green, blue = colour
        colour = (0.62 * red, 0.62 * green, 0.62 * blue)
        beside = [m.name for m in METHODS.values() if m.counterpart == method.counterpart]
        dashes = _DASHES[beside.index(name)]
    return {
        "color": colour,
        "linestyle": dashes,
        "linewidth": 1.8 if method.constrained else 1.3,
        "zorder": 3 if method.constrained else 4,
        "label": f"{name} ({method.title})",
    }


def method_handles(names: Iterable[str]) -> list[Line2D]:
    """Legend entries of the methods' curves."""
    from matplotlib.lines import Line2D

    return [
        Line2D([], [], **{k: v for k, v in line_style(name).items() if k != "zorder"})
        for name in names
    ]
