"""Matplotlib figures: in a notebook, as files, and as SVG inside a page."""

from __future__ import annotations

import base64
import html
import io
import re
from pathlib import Path

import matplotlib as mpl
from matplotlib.figure import Figure

from qp_twist.drawing.palette import RC
from qp_twist.files import whole_file

METHOD = "method:"
"""Prefix of the gid of an artist that a page shows and hides with a method."""
SVG_RC = RC | {
    "svg.fonttype": "none",  # text stays text: smaller, and it can be searched and read aloud
    "path.simplify_threshold": 0.3,
    "axes.facecolor": "none",
    "figure.facecolor": "none",
    "legend.fontsize": 8,
}

_NUMBER = re.compile(r"-?\d+\.\d{2,}")
_ID = re.compile(r' id="([^"]*)"')
_USED = re.compile(r'(?:url\(#|href="#)([^)"]+)')


class ShownFigure(Figure):
    """A Matplotlib figure that notebooks display as a picture.

    Matplotlib registers its figures with a notebook only if ``pyplot`` was imported or
    ``%matplotlib inline`` was run; then nothing changes.
    """

    def _repr_png_(self) -> bytes:
        file = io.BytesIO()
        self.savefig(file, format="png", dpi=self.dpi)
        return file.getvalue()


class Figures(dict[str, Figure]):
    """Figures by name; a notebook displays all of them."""

    def _repr_html_(self) -> str:
        pictures = []
        for name, figure in self.items():
            text = html.escape(name, quote=True)
            data = base64.b64encode(ShownFigure._repr_png_(figure)).decode()  # type: ignore[arg-type]
            pictures.append(
                f'<figure><figcaption>{text}</figcaption><img alt="{text}" '
                f'style="max-width:100%" src="data:image/png;base64,{data}"></figure>'
            )
        return "".join(pictures)


def save_figure(figure: Figure, path: Path) -> Path:
    """Write a PNG under a temporary name and rename it: a failure leaves no partial file."""
    with whole_file(path) as unfinished, mpl.rc_context(RC):
        figure.savefig(unfinished, format="png")
    return path


def inline_svg(figure: Figure, key: str, description: str) -> str:
    """The figure as an ``<svg>`` element with a text description.

    Ids begin with ``key``, so several figures fit into one page; unused ids are removed. Artists
    whose gid begins with ``method:`` get the classes ``m`` and ``m-NAME``.
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
    # Let the page set the width.
    text = re.sub(r' (?:width|height)="[\d.]+pt"', "", text, count=2)
    label = html.escape(description, quote=True)
    return text.replace("<svg", f'<svg role="img" aria-label="{label}"', 1)


def _rounded(number: re.Match[str]) -> str:
    return f"{float(number[0]):.1f}".removesuffix(".0")
