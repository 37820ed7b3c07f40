"""Tables with a row for each method, for a page or a terminal."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import NamedTuple

TIME = "µs per\nwaypoint"
"""Column of the metrics that is drawn, too."""


class Cell(NamedTuple):
    """A cell of a table."""

    text: str
    state: str = ""
    """``good``, ``bad``, or empty: how it is marked."""


class Table(NamedTuple):
    """A table with a row for each method."""

    columns: Sequence[str]
    rows: Mapping[str, Sequence[Cell]]

    def of(self, name: str, column: str) -> Cell:
        """The cell of a method."""
        return self.rows[name][self.columns.index(column)]
