"""A part of the report."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

from qp_twist.paths import METHODS


class ReportSection(NamedTuple):
    """A heading and its content."""

    key: str
    """Prefix of its anchor and ids."""
    title: str
    body: str
    """Content, HTML."""


@dataclass(frozen=True)
class Choice:
    """A method in the page's selector.

    Attributes:
        name: Name of the method.
        title: Title of the method.
        swatch: A piece of its line as SVG.
        shown: Whether it is shown when the page opens.
    """

    name: str
    title: str
    swatch: str
    shown: bool


FIRST_SHOWN = ("gradient_projection", "qp_gradient", "twa", "qp", "qp_planned")
"""Methods in the figures when the page opens; with fewer than three of them, all that ran."""


def shown_first(names: list[str]) -> list[str]:
    """The methods shown when the page opens: few enough to distinguish their lines."""
    found = [name for name in FIRST_SHOWN if name in names]
    return found if len(found) > 2 and len(names) > 5 else names


def kind(name: str) -> str:
    """Kind of a method: ``qp``, ``peer`` or ``closed``."""
    method = METHODS[name]
    return "qp" if method.constrained else "peer" if method.peer else "closed"
