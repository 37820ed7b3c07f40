"""Cycles of Klartext that lead the tool along its axis into a hole and back."""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass, field

from qp_twist.errors import InvalidInput
from qp_twist.paths.heidenhain_blocks import number
from qp_twist.paths.heidenhain_motions import feed_unit
from qp_twist.paths.machine_tool import Hole
from qp_twist.paths.toolpath_builder import ProgramBuilder

_BORED = {200: "drilling", 201: "reaming", 203: "universal drilling", 205: "pecking",
          206: "tapping", 207: "rigid tapping", 209: "tapping with chip breaking"}  # fmt: skip
_OLD = (1, 2)
"""Pecking and tapping of older controls, in lines: from where the tool is."""
_TAPPED = (2, 206, 207, 209)
"""The tool comes back at the feed, and not rapidly."""
_NAMES = {
    **dict.fromkeys(("DIST", "SET UP", "SETUP", "SET-UP", "ABST", "AVST"), "distance"),
    "DEPTH": "depth", "TIEFE": "depth", "F": "feed",
}  # fmt: skip


@dataclass
class Cycle:
    """A cycle that waits for its call.

    Attributes:
        kind: Its number.
        values: Its Q parameters by number, or of an older one the values of its lines by name.
        modal: Since M89: called after each motion.
    """

    kind: int
    values: dict[str, float] = field(default_factory=dict)
    modal: bool = False

    def hole(self, at: float, out: ProgramBuilder) -> Hole:
        """The hole where the tool is at a height, m.

        Raises:
            InvalidInput: If it is another cycle, or a value is missing.
        """
        old, q, scale = self.kind in _OLD, self.values, out.scale()
        if not old and self.kind not in _BORED:
            raise InvalidInput(
                f"cycle {self.kind} moves the tool in a way that is not read; have the CAM system "
                "write its motions"
            )
        needed = {"distance", "depth"} if old else {"200", "201", "203"}
        feed, pitch = q.get("feed" if old else "206"), q.get("239")
        if not needed <= q.keys() or (feed is None and pitch is None):
            raise InvalidInput(f"cycle {self.kind}: its depth or its feed is missing")
        stated = (scale * pitch, True) if pitch is not None else None
        if stated is None and feed is not None:
            stated = feed_unit(out) * feed, False
        if old:
            near, above, bottom = at, at, at - scale * (abs(q["distance"]) + abs(q["depth"]))
        else:
            near, bottom = scale * (q["203"] + q["200"]), scale * (q["203"] + q["201"])
            above = scale * (q["203"] + max(q["200"], q.get("204", 0.0)))
        return Hole(near, bottom, above, self.kind in _TAPPED, stated)


def cycle_of(kind: int, text: str, before: Cycle | None, parameters: Mapping[str, float]) -> Cycle:
    """A cycle by its definition; each line of an older one adds to it.

    Raises:
        InvalidInput: If a value is no number.
    """
    if kind in _OLD:
        values = dict(before.values) if before and before.kind == kind else {}
        match = re.match(r"([A-Z][A-Z -]*?)\s*([-+]?[0-9.,]+)$", text)
        if match and (name := _NAMES.get(match[1].strip())):
            values[name] = number(match[2], parameters)
        return Cycle(kind, values)
    if kind not in _BORED:
        return Cycle(kind)
    found = re.findall(r"Q0*([0-9]+) *= *([-+]? *(?:Q?[0-9][0-9.,]*|[.,][0-9]+))", text)
    values = {name: number(value, parameters) for name, value in found}
    if values.get("395"):
        raise InvalidInput(f"cycle {kind}, Q395: a depth of the cylindrical part is not read")
    return Cycle(kind, values)
