"""What holds in a G-code program until another word says otherwise."""

from __future__ import annotations

from dataclasses import dataclass

from qp_twist.paths.gcode_cycles import Drilling


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
