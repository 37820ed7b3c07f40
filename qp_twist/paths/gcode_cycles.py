"""Drilling cycles of G-code."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from qp_twist.errors import InvalidInput
from qp_twist.paths.machine_tool import Hole
from qp_twist.paths.program_values import numbers_of

_OUT_AT_FEED = (74, 84, 85, 89)
_SAME_DEPTH = 1e-6
CALLED = {"CYCLE81": "", "CYCLE82": "a dwell at the bottom", "CYCLE83": "pecks"}
"""Drilling cycles of SINUMERIK, and what of each is left out of the path."""


@dataclass
class Drilling:
    """The cycle in force.

    Attributes:
        code: Its G code.
        initial: Z before the first hole, m: where G98 leads back to.
        clear: R, where the feed begins, m.
        depth: Z of the bottom, m.
    """

    code: int
    initial: float
    clear: float | None = None
    depth: float | None = None

    def hole(
        self, words: Mapping[str, float], scale: float, *, relative: bool, to_initial: bool
    ) -> Hole:
        """The hole by R and Z: absolute, or by G91 R from the initial height and Z from R."""
        if "R" in words:
            self.clear = scale * words["R"] + (self.initial if relative else 0.0)
        if "Z" in words and not (relative and self.clear is None):
            self.depth = scale * words["Z"] + ((self.clear or 0.0) if relative else 0.0)
        if self.clear is None or self.depth is None:
            missing = "R" if self.clear is None else "Z"
            raise InvalidInput(f"G{self.code}: {missing} is not stated")
        if self.clear < self.depth:
            raise InvalidInput(f"G{self.code}: R is below Z, the bottom of the hole")
        above = max(self.initial, self.clear) if to_initial else self.clear
        return Hole(self.clear, self.depth, above, self.code in _OUT_AT_FEED)


def called_hole(call: str, scale: float) -> Hole:
    """The hole of CYCLE81, CYCLE82 or CYCLE83 ``(RTP, RFP, SDIS, DP, DPR, …)``.

    The tool goes to SDIS above the reference plane RFP, to the depth DP, or DPR below RFP, and back
    to RTP (SINUMERIK, *Cycles*).
    """
    back, plane, above, depth, below = (*numbers_of(call)[:5], *5 * [None])[:5]
    if back is None or (depth is None and below is None):
        raise InvalidInput(f"{call}: expected RTP, RFP, SDIS and DP or DPR")
    plane = plane or 0.0
    if depth is not None and below and abs(plane - abs(below) - depth) > _SAME_DEPTH:
        raise InvalidInput(
            f"{call}: DP and DPR are two depths, and controls differ in which of them counts; "
            "state one"
        )
    near, bottom = plane + abs(above or 0.0), plane - abs(below or 0.0) if depth is None else depth
    if near < bottom:
        raise InvalidInput(f"{call}: the reference plane is below the bottom of the hole")
    return Hole(scale * near, scale * bottom, scale * max(back, near))
