"""Cycles of Klartext that lead the tool along its axis into a hole and back."""

from __future__ import annotations

import re
from dataclasses import dataclass, field

from qp_twist.errors import InvalidInput
from qp_twist.paths.heidenhain_blocks import number
from qp_twist.paths.machine_tool import Hole
from qp_twist.paths.program_values import Variables
from qp_twist.paths.toolpath_builder import ProgramBuilder

_BORED = (200, 201, 203, 205, 206, 207, 209)
"""Drilling, reaming, universal drilling, pecking, tapping, rigid, and with chip breaking."""
_OLD = (1, 2)
"""Pecking and tapping of older controls, in lines: from where the tool is."""
_TAPPED = (2, 206, 207, 209)
"""The tool comes back at the feed, and not rapidly."""
_NAMES = {
    **dict.fromkeys(("DIST", "SET UP", "SETUP", "SET-UP", "ABST", "AVST"), "200"),
    "DEPTH": "201", "TIEFE": "201", "F": "206",
}  # fmt: skip
"""The Q parameter of newer cycles for a value of the older ones."""


@dataclass
class Cycle:
    """A cycle that waits for its call.

    Attributes:
        kind: Its number.
        values: Its Q parameters by number.
        modal: Since M89: called after each motion.
    """

    kind: int
    values: dict[str, float] = field(default_factory=dict)
    modal: bool = False

    def hole(self, at: float, out: ProgramBuilder) -> Hole:
        """The hole where the tool is at a height, m."""
        old, q, scale = self.kind in _OLD, self.values, out.scale()
        if not old and self.kind not in _BORED:
            raise InvalidInput(
                f"cycle {self.kind} moves the tool in a way that is not read; have the CAM system "
                "write its motions"
            )
        needed = {"200", "201"} if old else {"200", "201", "203"}
        if not needed <= q.keys() or not q.keys() & {"206", "239"}:
            raise InvalidInput(f"cycle {self.kind}: its depth or its feed is missing")
        turn = "239" in q
        feed = scale * q["239"] if turn else feed_unit(out) * q["206"]
        if old:
            bottom = at - scale * (abs(q["200"]) + abs(q["201"]))
            return Hole(at, bottom, at, self.kind in _TAPPED, (feed, turn))
        near, bottom = scale * (q["203"] + q["200"]), scale * (q["203"] + q["201"])
        above = scale * (q["203"] + max(q["200"], q.get("204", 0.0)))
        return Hole(near, bottom, above, self.kind in _TAPPED, (feed, turn))


def cycle_of(kind: int, text: str, before: Cycle | None, values: Variables) -> Cycle:
    """A cycle by its definition; each line of an older one adds to it."""
    if kind in _OLD:
        cycle = before if before and before.kind == kind else Cycle(kind)
        match = re.match(r"([A-Z][A-Z -]*?)\s*([-+]?[0-9.,]+)$", text)
        if match and (name := _NAMES.get(match[1].strip())):
            cycle.values[name] = number(match[2], values)
        return cycle
    stated = re.findall(r"Q0*([0-9]+) *= *([-+]? *(?:Q?[0-9][0-9.,]*|[.,][0-9]+))", text)
    if kind not in _BORED:
        return Cycle(kind)
    cycle = Cycle(kind, {name: number(value, values) for name, value in stated})
    if cycle.values.get("395"):
        raise InvalidInput(f"cycle {kind}, Q395: a depth of the cylindrical part is not read")
    return cycle


def feed_unit(out: ProgramBuilder) -> float:
    """The unit of F, m: mm, or tenths of an inch, per minute."""
    return (0.1 if out.length_unit == "inch" else 1.0) * out.scale()
