"""A drawing with its caption, and curves with few points."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

THINNED = 240
"""Approximate number of points of a curve."""


def thinned(count: int, keep: npt.NDArray[np.intp] | None = None) -> npt.NDArray[np.intp]:
    """Indices of about ``THINNED`` of ``count`` points, the ends and those of ``keep`` included."""
    chosen = np.linspace(0, count - 1, min(count, THINNED)).round().astype(np.intp)
    return np.unique(chosen if keep is None else np.concatenate([chosen, keep]))


def figure_html(svg: str, caption: str) -> str:
    """An SVG with its caption, HTML."""
    return f'<figure><div class="drawing">{svg}</div><figcaption>{caption}</figcaption></figure>'
