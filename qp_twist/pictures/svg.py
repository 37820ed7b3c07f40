"""Matplotlib figures as inline SVG."""

from __future__ import annotations

import html
import io
import re
from collections.abc import Mapping

import matplotlib as mpl
from matplotlib.figure import Figure

from qp_twist.pictures.style import RC

METHOD = "method:"
"""Prefix of the gid of an artist that is shown and hidden with a method."""
SVG_RC = RC | {
    "svg.fonttype": "none",  # text stays text: smaller, and it can be searched and read aloud
    "path.simplify_threshold": 0.3,
    "legend.fontsize": 8,
}

_NUMBER = re.compile(r"-?\d+\.\d{2,}")
_ID = re.compile(r' id="([^"]*)"')
_USED = re.compile(r'(?:url\(#|href="#)([^)"]+)')


def inline_svg(
    figure: Figure, key: str, description: str, variables: Mapping[str, str] = {}
) -> str:
    """The figure as an ``<svg>`` element with a text description.

    Ids begin with ``key``, so several figures fit into one page; unused ids are removed. Artists
    whose gid begins with ``method:`` get the classes ``m`` and ``m-NAME``.

    Args:
        figure: The figure.
        key: Prefix of the ids.
        description: What it shows.
        variables: Variables of the page's style, such as ``"--ink"``, by the colour of the figure
            (``"#1b1f24"``) that they replace.
    """
    file = io.StringIO()
    with mpl.rc_context(SVG_RC | {"svg.hashsalt": f"qp_twist {key}"}):
        figure.savefig(file, format="svg", metadata={"Date": None, "Creator": None})
    text = file.getvalue()
    text = text[text.index("<svg") :]
    text = re.sub(r"<metadata>.*?</metadata>", "", text, flags=re.DOTALL)
    text = re.sub(r'<g id="method:([^"]*)">', r'<g class="m m-\1">', text)
    used = set(_USED.findall(text))
    text = _ID.sub(lambda m: f' id="{key}-{m[1]}"' if m[1] in used else "", text)
    text = re.sub(r'(url\(#|href="#)', rf"\g<1>{key}-", text)
    # A tenth of a pixel is as good as a millionth.
    text = re.sub(r' (?:d|points)="[^"]*"', lambda m: _NUMBER.sub(_rounded, m[0]), text)
    text = re.sub(
        r"font: ((?:bold |700 )?[\d.]+px) [^;\"]*sans-serif", r"font: \1 sans-serif", text
    )
    text = re.sub(r"\s*\n\s*", "\n", text)
    for colour, variable in variables.items():
        text = text.replace(f": {colour}", f": var({variable})")
    # Let the page set the width.
    text = re.sub(r' (?:width|height)="[\d.]+pt"', "", text, count=2)
    label = html.escape(description, quote=True)
    return text.replace("<svg", f'<svg role="img" aria-label="{label}"', 1)


def _rounded(number: re.Match[str]) -> str:
    return f"{float(number[0]):.1f}".removesuffix(".0")
