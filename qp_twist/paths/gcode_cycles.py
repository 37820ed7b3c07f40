"""What holds in a G-code program until another word says otherwise; its drilling cycles."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from qp_twist.errors import InvalidInput
from qp_twist.paths.machine_tool import Hole

CYCLES: dict[float, str] = {
    81: "", 82: "a dwell at the bottom", 73: "pecks", 83: "pecks", 74: "the turn of the tap",
    84: "the turn of the tap", 85: "", 86: "a stop of the spindle at the bottom",
    89: "a dwell at the bottom",
}  # fmt: skip
"""Drilling cycles, and what of each is left out of the path (FANUC, Haas, LinuxCNC)."""
_OUT_AT_FEED = (74, 84, 85, 89)


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
        """The hole by R and Z: absolute, or by G91 R from the initial height and Z from R.

        Raises:
            InvalidInput: If R or Z is not stated, or R is below the bottom.
        """
        if "R" in words:
            self.clear = scale * words["R"] + (self.initial if relative else 0.0)
        if "Z" in words:
            if relative and self.clear is None:
                raise InvalidInput(f"G{self.code}: Z is relative (G91) to R, which is not stated")
            self.depth = scale * words["Z"] + ((self.clear or 0.0) if relative else 0.0)
        if self.clear is None or self.depth is None:
            missing = "R" if self.clear is None else "Z"
            raise InvalidInput(f"G{self.code}: {missing} is not stated")
        if self.clear < self.depth:
            raise InvalidInput(f"G{self.code}: R is below Z, the bottom of the hole")
        above = max(self.initial, self.clear) if to_initial else self.clear
        return Hole(self.clear, self.depth, above, self.code in _OUT_AT_FEED)


@dataclass
class Modes:
    """What holds until another G code says otherwise."""

    motion: int | None = None  # G0 to G3
    plane: int = 17  # to 19
    relative: bool = False  # coordinates
    absolute_centres: bool | None = None  # of arcs; None: nothing states it
    feed: int = 94  # per minute; 95 per turn of the spindle, 93 motions per minute
    to_initial: bool = True  # after a hole: G98, or to R by G99
    filament_relative: bool = False  # E of a 3-D printer
    rounding: float = 0.0  # RNDM: of each corner
    cycle: Drilling | None = None
