"""Cycles of Klartext that lead the tool along its axis into a hole and back."""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass

from qp_twist.errors import InvalidInput
from qp_twist.paths.heidenhain_blocks import number

_BORED = {200: "drilling", 201: "reaming", 203: "universal drilling", 205: "pecking",
          206: "tapping", 207: "rigid tapping", 209: "tapping with chip breaking"}  # fmt: skip
_TAPPED = (206, 207, 209)
"""The tool comes back at the feed, and not rapidly."""
_OLD = (1, 2)
"""Pecking and tapping of older controls, in lines: from where the tool is."""
_NAMES = {
    **dict.fromkeys(("DIST", "SET UP", "SETUP", "SET-UP", "ABST", "AVST"), "distance"),
    "DEPTH": "depth", "TIEFE": "depth", "F": "feed",
}  # fmt: skip


@dataclass
class Hole:
    """A cycle that waits for its call; heights in the unit of the program, along the tool.

    Attributes:
        kind: Number of the cycle.
        bottom: Height of the bottom, absolute; of older cycles, below where the tool is.
        near: Height at which the feed begins, absolute; ``None`` where the tool is.
        above: Height to which the tool comes back, likewise.
        feed: Per minute.
        pitch: Of a thread, per turn, instead of a feed.
        values: Of the lines of an older cycle so far.
        modal: Since M89: called after each motion.
    """

    kind: int
    bottom: float | None = None
    near: float | None = None
    above: float | None = None
    feed: float | None = None
    pitch: float | None = None
    values: dict[str, float] | None = None
    modal: bool = False

    @property
    def tapped(self) -> bool:
        """Whether the tool comes back at the feed."""
        return self.kind in _TAPPED or self.kind == 2

    def checked(self) -> Hole:
        """The cycle, if it is one that is read.

        Raises:
            InvalidInput: If it is another one, or a value is missing.
        """
        if self.kind not in (*_BORED, *_OLD):
            raise InvalidInput(
                f"cycle {self.kind} moves the tool in a way that is not read; have the CAM system "
                "write its motions"
            )
        if self.bottom is None or (self.feed is None and self.pitch is None):
            raise InvalidInput(f"cycle {self.kind}: its depth or its feed is missing")
        return self


def hole_of(kind: int, text: str, before: Hole | None, parameters: Mapping[str, float]) -> Hole:
    """A cycle by its definition; each line of an older one adds to it.

    Raises:
        InvalidInput: If a value is no number.
    """
    if kind in _OLD:
        values = dict(before.values or {}) if before and before.kind == kind else {}
        match = re.match(r"([A-Z][A-Z -]*?)\s*([-+]?[0-9.,]+)$", text)
        name = _NAMES.get(match[1].strip()) if match else None
        if match and name:
            values[name] = number(match[2], parameters)
        distance, depth = values.get("distance"), values.get("depth")
        bottom = None if distance is None or depth is None else abs(distance) + abs(depth)
        return Hole(kind, bottom, feed=values.get("feed"), values=values)
    if kind not in _BORED:
        return Hole(kind)
    q = {
        int(name): number(value, parameters)
        for name, value in re.findall(
            r"Q([0-9]+) *= *([-+]? *(?:Q?[0-9][0-9.,]*|[.,][0-9]+))", text
        )
    }
    if q.get(395):
        raise InvalidInput(f"cycle {kind}, Q395: a depth of the cylindrical part is not read")
    if not {200, 201, 203} <= q.keys():
        return Hole(kind)
    surface = q[203]
    near = surface + q[200]
    return Hole(
        kind, surface + q[201], near, surface + max(q[200], q.get(204, 0.0)),
        q.get(206), q.get(239),
    )  # fmt: skip
