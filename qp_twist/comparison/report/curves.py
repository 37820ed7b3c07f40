"""One curve per method over the waypoints, labelled at its end."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING

import numpy as np

from qp_twist.checks import Array
from qp_twist.pictures.figure_html import thinned
from qp_twist.pictures.style import line_style
from qp_twist.pictures.svg import METHOD

if TYPE_CHECKING:
    from matplotlib.axes import Axes

_APART = 0.062
"""Least distance of two labels, as a share of a panel's height."""


def draw_curves(panel: Axes, curves: Mapping[str, Array]) -> None:
    """Draw curves over the waypoints, counted from 1. Set the scale and the view first or after."""
    for name, values in curves.items():
        peaks = np.array([np.argmin(values), np.argmax(values)], dtype=np.intp)
        index = thinned(len(values), peaks)
        style = line_style(name) | {"label": "_"}
        panel.plot(index + 1, values[index], **style, gid=f"{METHOD}{name}")
    panel.margins(x=0.0)


def label_ends(panel: Axes, curves: Mapping[str, Array]) -> None:
    """The method's name at the right of each curve's end, moved apart where they would collide.

    Needs the panel's final view.
    """
    ends = {name: _share(panel, float(values[-1])) for name, values in curves.items()}
    order = sorted(ends, key=ends.__getitem__)
    places = spread([ends[name] for name in order], _APART)
    # Inside the panel, or the figure's edge would cut them off.
    last = len(places) - 1
    places = [max(place, k * _APART) for k, place in enumerate(places)]
    places = [min(place, 1.0 - (last - k) * _APART) for k, place in enumerate(places)]
    for name, place in zip(order, places, strict=True):
        colour = line_style(name)["color"]
        panel.annotate(
            name, (len(curves[name]), _value(panel, ends[name])), xytext=(1.035, place),
            textcoords=panel.transAxes, va="center", fontsize=7.5, color=colour,
            annotation_clip=False, gid=f"{METHOD}{name}",
            arrowprops={"arrowstyle": "-", "color": colour, "linewidth": 0.6, "shrinkA": 1,
                        "shrinkB": 1, "relpos": (0.0, 0.5), "patchA": None,
                        "gid": f"{METHOD}{name}"},
        )  # fmt: skip


def spread(places: list[float], apart: float) -> list[float]:
    """Sorted numbers moved as little as possible to be ``apart``."""
    groups = [[place] for place in places]
    centres = list(places)
    index = 1
    while index < len(groups):
        half = 0.5 * apart * (len(groups[index - 1]) + len(groups[index]))
        if centres[index] - centres[index - 1] < half:
            groups[index - 1] += groups.pop(index)
            centres.pop(index)
            centres[index - 1] = sum(groups[index - 1]) / len(groups[index - 1])
            index = max(1, index - 1)
        else:
            index += 1
    return [
        centre + apart * (k - 0.5 * (len(group) - 1))
        for group, centre in zip(groups, centres, strict=True)
        for k in range(len(group))
    ]


def _share(panel: Axes, value: float) -> float:
    """Position of a value in the panel, 0 at the bottom, 1 at the top."""
    low, high = panel.get_ylim()
    if panel.get_yscale() == "log":
        low, high, value = np.log10(low), np.log10(high), np.log10(max(value, 1e-300))
    return float(np.clip((value - low) / (high - low), 0.0, 1.0))


def _value(panel: Axes, share: float) -> float:
    low, high = panel.get_ylim()
    if panel.get_yscale() == "log":
        return float(10.0 ** (np.log10(low) + share * (np.log10(high) - np.log10(low))))
    return float(low + share * (high - low))
