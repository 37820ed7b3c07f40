"""Words of APT-CL, as dialects write them: what moves nothing, what changes the path, units."""

from __future__ import annotations

from typing import NamedTuple

from qp_twist.files import LengthUnit
from qp_twist.paths.apt_statements import NUMBER, Statement, number
from qp_twist.paths.arcs import ArcAxis

TEXT = ("PARTNO", "PPRINT", "REMARK", "INSERT", "TPRINT", "MACHIN", "TITLES", "DISPLY", "PAINT",
         "CSI_")  # fmt: skip
"""Words followed by free text, or that concern only the operator or the machine."""

IGNORED = frozenset({
    *TEXT, "COOLNT", "LOAD", "SELCTL", "SELECT", "TOOLNO", "SPINDL", "MULTAX",
    "CUTTER", "TLDATA", "INTOL", "OUTTOL", "TOLER", "LINTOL", "MCHTOL", "AUTOPS", "PSIS",
    "MCHFIN", "AUXFUN", "PREFUN", "SEQNO", "OPSKIP", "LEADER", "DELAY", "DWELL", "STOP", "OPSTOP",
    "CLRSRF", "CLAMP", "SETUP", "HEAD", "PROBE", "VERIFY", "TMARK", "CLDIST", "ARCSLP", "ISN",
    "REWIND", "SWITCH", "SELECTL", "OUTOL", "SEQUENCE", "CALSUB",
    "END-OF-PATH", "END", "FINI", "NOPOST", "CLPRNT", "PRINT", "AIR", "COUPLE", "PPWORD",
})  # fmt: skip
"""Words that do not change the path between two points."""

BREAKS = frozenset({"GOHOME", "HOME", "RETRCT", "RAPTO", "LOADTL", "UNLOAD", "TURRET"})
"""Words after which the tool is at an unknown point."""

CHANGES = {
    "ARC": "a circular move", "INDIRP": "a move along a surface",
    "TLLFT": "a move along a surface", "TLRGT": "a move along a surface",
    "GOBACK": "a move along a surface", "GOLFT": "a move along a surface",
    "GORGT": "a move along a surface", "GOUP": "a move along a surface",
    "GODOWN": "a move along a surface",
    "GOCLER": "a move to a plane", "SPLINE": "a curved move", "TRACUT": "a change of coordinates",
    "ORIGIN": "a change of coordinates", "TRANS": "a change of coordinates",
    "ROTATE": "a turn of the part", "ROTABL": "a turn of the part",
    "COPY": "a repetition", "INDEX": "a repetition", "MIRROR": "a mirrored path",
    "THREAD": "a thread", "OFSTNO": "a shifted path",
}  # fmt: skip
"""Words that change the path in a way that this reader does not support."""

PER_MINUTE: dict[str, LengthUnit | None] = {
    "MMPM": "mm", "MMPMIN": "mm", "IPM": "inch", "INPM": "inch", "MPM": "m",
    "UPM": None, "PERMIN": None,
}  # fmt: skip
"""Units of a feed per minute; ``None``: the file's own unit of length."""
PER_TURN: dict[str, LengthUnit | None] = {
    "MMPR": "mm", "IPR": "inch", "UPR": None, "PERREV": None,
}  # fmt: skip
"""Units of a feed per turn of the spindle."""
FEED_UNITS = {**PER_MINUTE, **PER_TURN}
UNITS: dict[str, LengthUnit] = {
    "MM": "mm", "MMS": "mm", "INCHES": "inch", "INCH": "inch", "IN": "inch", "M": "m",
    "METERS": "m",
}  # fmt: skip


class Dialect(NamedTuple):
    """What the files of a CAM system have in common.

    Attributes:
        name: Of the system.
        words: Its files have one of these, alone or with its first argument.
        sense: Of the motion about the axis that a circle states.
    """

    name: str
    words: frozenset[str]
    sense: ArcAxis


DIALECTS = (
    # Its manual calls the axis that of a clockwise motion.
    Dialect("Siemens NX", frozenset({"TOOL PATH"}), "left"),
    # In public files of 41 parts, straight motions beside a circle continue it without a corner if
    # it is right-handed, but for 42 of 1,900 in three of them; those looked at turn back there.
    Dialect("CAMWorks", frozenset({"UNIT", "TRNTYP"}), "right"),
    # Autodesk's post keeps the axis for a clockwise motion, and turns it round for the other.
    Dialect("CAMplete", frozenset({"MCS"}), "left"),
    # Creo Manufacturing, CL Output for Circular Interpolation.
    Dialect("Creo", frozenset({"$$->"}), "right"),
    # Autodesk's post turns the axis round for a clockwise motion.
    Dialect("ISO 4343", frozenset({"MOVARC CENTER"}), "right"),
)


def changes_nothing(of: Statement) -> bool:
    """Whether a word that may change the path does not: a cycle's end, a shift by zero."""
    if of.word == "OFSTNO":
        return "OFF" in of.arguments
    if of.word == "TRACUT":
        return of.arguments == ["NOMORE"]
    if of.word in ("ORIGIN", "TRANS") and of.arguments:
        numbers = [NUMBER.fullmatch(argument) for argument in of.arguments]
        return all(numbers) and not any(number(of.word, a) for a in of.arguments)
    return False
