"""What the codes and words of G-code mean: tables."""

from __future__ import annotations

from typing import Any

from qp_twist.paths.gcode_cycles import CALLED
from qp_twist.paths.tool_axis import BY_VECTOR

DRILLING: dict[float, str] = {
    81: "", 82: "a dwell at the bottom", 73: "pecks", 83: "pecks", 74: "the turn of the tap",
    84: "the turn of the tap", 85: "", 86: "a stop of the spindle at the bottom",
    89: "a dwell at the bottom",
}  # fmt: skip
"""Drilling cycles, and what of each is left out of the path (FANUC, Haas, LinuxCNC)."""
_RADIUS = "a shift by the tool's radius"
REFUSED: dict[float, str] = {
    **dict.fromkeys((5, 5.1, 5.2, 5.3, 6, 6.1, 6.2), "a spline"),
    7: "a lathe's diameter", 8: "a lathe's radius",
    12: "a circular pocket", 13: "a circular pocket", 16: "polar coordinates",
    12.1: "polar interpolation", 7.1: "cylindrical interpolation",
    **dict.fromkeys((31, 38.2, 38.3, 38.4, 38.5), "a measurement"),
    **dict.fromkeys((33, 331, 332), "a thread"),
    **dict.fromkeys((41, 42, 41.1, 42.1, 41.2, 42.2), _RADIUS),
    51: "a scaled path", 51.1: "a mirrored path", 92.3: "a shift of coordinates",
    65: "a call of a macro", 66: "a call of a macro",
    **dict.fromkeys((68.1, 68.3, 68.4, 254), "turned coordinates"),
    **dict.fromkeys((71.1, 71.2, 72, 72.1, 72.2), "a lathe's cycle"),
    **dict.fromkeys((76, 87, 88), "a boring cycle"),
}  # fmt: skip
INSTEAD = {_RADIUS: "write the path of the tool's centre (G40)"}
CODES: dict[float, tuple[str, Any]] = {
    **{code: ("refused", what) for code, what in REFUSED.items()},
    **dict.fromkeys((
        4, 9, 13.1, 15, 40, 43, 43.1, 43.2, 44, 50.1, 50.2, 60, 61, 61.1, 62, 63, 64, 67, 94, 96,
        97, 103, 187, 290, 291, 450, 451, 601, 602, 603, 641, 642, 643, 644, 645,
    ), ("passed", None)),
    **dict.fromkeys((11, 22, 23, 25, 26, 29, 32, 34, 50), ("bare", None)),
    **{code: ("motion", code) for code in (0, 1, 2, 3)},
    **{code: ("plane", code) for code in (17, 18, 19)},
    **{code: ("feed", code) for code in (93, 94, 95)},
    90: ("relative", False), 91: ("relative", True),
    90.1: ("absolute_centres", True), 91.1: ("absolute_centres", False),
    98: ("to_initial", True), 99: ("to_initial", False),
    **dict.fromkeys((20, 70, 700), ("unit", "inch")),
    **dict.fromkeys((21, 71, 710), ("unit", "mm")),
    **dict.fromkeys((54, 55, 56, 57, 58, 59, 54.1, 54.2, 59.1, 59.2, 59.3, 154,
                     500, 505, 506, 507, 508, 509), ("offset", None)),
    **dict.fromkeys(DRILLING, ("drilling", None)),
    **dict.fromkeys((10, 52, 53.1, 68, 68.2, 69, 80, 92, 92.1, 92.2), ("frame", None)),
    **dict.fromkeys((43.4, 43.5, 234), ("tip", True)), 49: ("tip", False),
    **dict.fromkeys((28, 30, 53, 153), ("away", None)),
}  # fmt: skip
"""What each G code does, and a value: a mode that holds, a unit, … ``bare`` codes do not change the
path if their block has no coordinates; after ``tip`` X, Y, Z are those of the tool's tip."""
MODES = {"motion", "plane", "feed", "relative", "absolute_centres", "to_initial", "unit"}
"""Groups of codes of which a block has one: which of two counts depends on the control."""
KINEMATICS = {428.0: True, 429.0: False}
"""LinuxCNC's switches of a five-axis machine: with control of the tool's tip, and without."""
AWAY = frozenset(code for code, (kind, _) in CODES.items() if kind == "away")
CYCLES = ("CYCLE832", "CYCLE800", *CALLED)
"""Cycles of SINUMERIK that are read."""
ENDS = (2, 30, 99, 17)
KNOWN = frozenset({
    *"XYZABCEIJKRFSTDHPQLNO@^", "CR", "RPL", "RND", "RNDM", "CHF", "CHR", "FRC", "FRCM", "CTOL",
    "ADIS", "ADISPOS",
    "S1", "S2", "M1", "M2", "M3", "I1", "J1", "K1", *BY_VECTOR,
})  # fmt: skip
MOVING = frozenset({*"XYZABCIJKR@^", *BY_VECTOR, "CR", "I1", "J1", "K1"})
RELATIVE = frozenset({*"XYZABC@^", "I1", "J1", "K1"})
"""Words that G91 makes relative."""
OWN_WORDS = frozenset({4, 10, 43.1, 52, 68, 68.2, 92})
"""Codes whose X, Y, Z, … are no target of a motion."""
