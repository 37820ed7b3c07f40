"""A sample of a method's line, as in the figures."""

from __future__ import annotations

from matplotlib.colors import to_hex

from qp_twist.pictures.style import line_style


def swatch(name: str) -> str:
    """An SVG of a line with the method's colour and dashes."""
    style = line_style(name)
    dashes = ""
    if style["linestyle"] != "solid":
        width = style["linewidth"]
        lengths = " ".join(f"{width * length:g}" for length in style["linestyle"][1])
        dashes = f' stroke-dasharray="{lengths}"'
    return (
        '<svg class="swatch" width="34" height="10" aria-hidden="true"><line x1="1" y1="5" x2="33" '
        f'y2="5" stroke="{to_hex(style["color"])}" stroke-width="{style["linewidth"] + 0.4:g}"'
        f"{dashes}/></svg>"
    )
