"""How a method is drawn: one colour per QP, solid; its closed forms dashed."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import Any

import numpy as np
from matplotlib.colors import to_hex, to_rgb
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from qp_twist.checks import Array
from qp_twist.drawing.charts import Curve
from qp_twist.drawing.figures import METHOD
from qp_twist.drawing.palette import BLACK, BLUE, GREEN, ORANGE, PINK
from qp_twist.paths import METHODS

_COLOURS = {
    "qp_rmr": ORANGE, "qp_minimum_norm": GREEN, "qp_gradient": PINK, "qp": BLUE,
    "qp_planned": BLACK,
}  # fmt: skip
# Used in turn for the closed forms and peers of one QP.
_DASHES: tuple[Any, ...] = (
    (0, (4, 2)), (0, (1, 1.5)), (0, (6, 1.5, 1, 1.5)),
    (0, (2, 1)), (0, (8, 2)), (0, (4, 1, 1, 1, 1, 1)),
)  # fmt: skip


def line_style(name: str) -> dict[str, Any]:
    """Matplotlib keywords of a method's curve."""
    method = METHODS[name]
    colour = to_rgb(_COLOURS[method.qp])
    if method.constrained:
        dashes: Any = "solid"
    else:
        # Darker, so that dashes show on top of their counterpart's line.
        colour = tuple((0.62 * np.array(colour)).tolist())
        beside = [m.name for m in METHODS.values() if m.counterpart == method.counterpart]
        dashes = _DASHES[beside.index(name)]
    return {
        "color": colour, "linestyle": dashes, "linewidth": 1.8 if method.constrained else 1.3,
        "zorder": 3 if method.constrained else 4, "label": f"{name} ({method.title})",
    }  # fmt: skip


def method_curves(values: Mapping[str, Array]) -> list[Curve]:
    """The curves of methods over the waypoints; a page shows and hides each."""
    return [
        Curve.of(y, line_style(name) | {"gid": f"{METHOD}{name}"}) for name, y in values.items()
    ]


def method_handles(names: Iterable[str]) -> list[Line2D]:
    """Legend entries of the methods' curves."""
    return [
        Line2D([], [], **{k: v for k, v in line_style(name).items() if k != "zorder"})
        for name in names
    ]


def entitle(figure: Figure, title: str, handles: list[Any]) -> None:
    """A title at the left, and a legend below; the panels fill what is between."""
    figure.suptitle(title, x=0.01, ha="left", fontsize=11, fontweight="bold")
    if figure.get_layout_engine() is not None:
        figure.legend(handles=handles, loc="outside lower center", ncols=3)
        return
    figure.legend(handles=handles, loc="lower center", ncols=3)
    width, height = figure.get_size_inches()
    below = 0.58 + 0.19 * -(-len(handles) // 3)
    figure.subplots_adjust(
        left=0.78 / width, right=1.0 - 0.15 / width, bottom=below / height,
        top=1.0 - 0.6 / height, hspace=0.32, wspace=0.2,
    )  # fmt: skip


def swatch(name: str) -> str:
    """A piece of a method's line, as SVG."""
    style = line_style(name)
    dashes = ""
    if style["linestyle"] != "solid":
        lengths = " ".join(f"{style['linewidth'] * part:g}" for part in style["linestyle"][1])
        dashes = f' stroke-dasharray="{lengths}"'
    return (
        '<svg class="swatch" width="34" height="10" aria-hidden="true"><line x1="1" y1="5" x2="33" '
        f'y2="5" stroke="{to_hex(style["color"])}" stroke-width="{style["linewidth"] + 0.4:g}"'
        f"{dashes}/></svg>"
    )


def kind(name: str) -> str:
    """Kind of a method: ``qp``, ``peer`` or ``closed``."""
    method = METHODS[name]
    return "qp" if method.constrained else "peer" if method.peer else "closed"
