"""What the words of G-code mean: tables."""

from __future__ import annotations

from qp_twist.files import LengthUnit
from qp_twist.paths.gcode_tool_axis import BY_VECTOR

BARE = frozenset({11, 22, 23, 25, 26, 29, 32, 34, 50})
"""G codes that do not change the path if their block has no coordinates."""
PASSED = frozenset({
    *BARE, 4, 9, 13.1, 15, 40, 43, 43.1, 43.2, 44, 49, 50.1, 50.2, 60, 61, 61.1, 62, 63, 64, 67,
    94, 96, 97, 103, 187, 290, 291, 450, 451, 601, 602, 603, 641, 642, 643, 644, 645,
})  # fmt: skip
"""G codes that do not change it."""
TIP_ON = frozenset({43.4, 43.5, 234.0})
"""G codes after which X, Y, Z are those of the tool's tip, whatever its axis."""
OFFSETS = frozenset({54, 55, 56, 57, 58, 59, 54.1, 54.2, 59.1, 59.2, 59.3, 154, 500,
                      505, 506, 507, 508, 509})  # fmt: skip
REFUSED: dict[float, str] = {
    **dict.fromkeys((5, 5.1, 5.2, 5.3, 6, 6.1, 6.2), "a spline"),
    7: "a lathe's diameter", 8: "a lathe's radius",
    12: "a circular pocket", 13: "a circular pocket", 16: "polar coordinates",
    12.1: "polar interpolation", 7.1: "cylindrical interpolation",
    31: "a measurement", 33: "a thread", 38.2: "a measurement", 38.3: "a measurement",
    38.4: "a measurement", 38.5: "a measurement", 331: "a thread", 332: "a thread",
    41: "a shift by the tool's radius", 42: "a shift by the tool's radius",
    41.1: "a shift by the tool's radius", 42.1: "a shift by the tool's radius",
    41.2: "a shift by the tool's radius", 42.2: "a shift by the tool's radius",
    51: "a scaled path", 51.1: "a mirrored path", 92.3: "a shift of coordinates",
    65: "a call of a macro", 66: "a call of a macro", 68.1: "turned coordinates",
    68.3: "turned coordinates", 68.4: "turned coordinates", 254: "turned coordinates",
    **dict.fromkeys((71.1, 71.2, 72, 72.1, 72.2), "a lathe's cycle"), 76: "a boring cycle",
    87: "a boring cycle", 88: "a boring cycle",
}  # fmt: skip
INSTEAD: dict[float, str] = {
    **dict.fromkeys((41, 42, 41.1, 42.1, 41.2, 42.2), "write the path of the tool's centre (G40)"),
}
UNITS: dict[float, LengthUnit] = {
    **dict.fromkeys((20, 70, 700), "inch"), **dict.fromkeys((21, 71, 710), "mm"),
}  # fmt: skip
FRAME_CODES = frozenset({10, 52, 53.1, 68, 68.2, 69, 80, 92, 92.1, 92.2})
"""G codes of frames of coordinates; and G80, after which there is no drilling."""
MODAL: dict[float, tuple[str, int]] = {
    **{code: ("motion", code) for code in (0, 1, 2, 3)},
    **{code: ("plane", code) for code in (17, 18, 19)},
    90: ("relative", False), 91: ("relative", True),
    90.1: ("absolute_centres", True), 91.1: ("absolute_centres", False),
    93: ("feed", 93), 94: ("feed", 94), 95: ("feed", 95),
    98: ("to_initial", True), 99: ("to_initial", False),
}  # fmt: skip
"""Codes that hold until another of their group: name and value of the mode."""
AWAY = frozenset({28, 30, 53, 153})
"""Codes of motions to positions of the machine."""
KINEMATICS = {428.0: True, 429.0: False}
"""LinuxCNC's switches of a five-axis machine: with control of the tool's tip, and without."""
CALLS = (97, 98, 198)
ENDS = (2, 30, 99, 17)
LETTERS = frozenset("XYZABCEIJKRFSTDHPQL")
OTHERS = frozenset({"N", "O", "CR", "RPL", "RND", "RNDM", "CHF", "CHR", "FRC", "FRCM", "CTOL",
                     "S1", "S2", "M1", "M2", "M3", *BY_VECTOR})  # fmt: skip
KNOWN = LETTERS | OTHERS
MOVING = frozenset({*"XYZABCIJKR", *BY_VECTOR, "CR"})
OWN_WORDS = frozenset({4, 10, 43.1, 52, 68, 68.2, 92})
"""Codes whose X, Y, Z, … are no target of a motion."""
