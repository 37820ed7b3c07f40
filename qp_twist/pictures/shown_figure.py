"""Matplotlib figures that a notebook displays by themselves."""

from __future__ import annotations

import base64
import html
import io

from matplotlib.figure import Figure


class ShownFigure(Figure):
    """A Matplotlib figure that notebooks display as a picture.

    Matplotlib registers its figures with a notebook only if ``pyplot`` was imported or
    ``%matplotlib inline`` was run; then nothing changes.
    """

    def _repr_png_(self) -> bytes:
        return _png(self)


class Figures(dict[str, Figure]):
    """Figures by name; a notebook displays all of them."""

    def _repr_html_(self) -> str:
        pictures = []
        for name, figure in self.items():
            text = html.escape(name, quote=True)
            data = base64.b64encode(_png(figure)).decode()
            pictures.append(
                f'<figure><figcaption>{text}</figcaption><img alt="{text}" '
                f'style="max-width:100%" src="data:image/png;base64,{data}"></figure>'
            )
        return "".join(pictures)


def _png(figure: Figure) -> bytes:
    file = io.BytesIO()
    figure.savefig(file, format="png", dpi=figure.dpi)
    return file.getvalue()
