"""Words of APT-CL, as dialects write them: what moves nothing, what changes the path."""

from __future__ import annotations

from qp_twist.paths.apt_statements import NUMBER, Statement, not_read, number
from qp_twist.paths.arcs import ArcAxis

TEXT = ("PARTNO", "PPRINT", "REMARK", "INSERT", "TPRINT", "MACHIN", "TITLES", "DISPLY", "PAINT",
         "CSI_")  # fmt: skip
"""Words followed by free text, or that concern only the operator or the machine."""

CHANGES = {
    **dict.fromkeys(
        ("INDIRP", "TLLFT", "TLRGT", "GOBACK", "GOLFT", "GORGT", "GOUP", "GODOWN"),
        "a move along a surface",
    ),
    "ARC": "a circular move", "SPLINE": "a curved move", "GOCLER": "a move to a plane",
    "TRACUT": "a change of coordinates",
    "ORIGIN": "a change of coordinates", "TRANS": "a change of coordinates",
    "ROTATE": "a turn of the part", "ROTABL": "a turn of the part",
    "COPY": "a repetition", "INDEX": "a repetition", "MIRROR": "a mirrored path",
    "THREAD": "a thread", "OFSTNO": "a shifted path",
}  # fmt: skip
"""Words that change the path in a way that this reader does not support."""

IGNORED = frozenset({
    *TEXT, *CHANGES, "COOLNT", "LOAD", "SELCTL", "SELECT", "TOOLNO",
    "CUTTER", "TLDATA", "INTOL", "OUTTOL", "TOLER", "LINTOL", "MCHTOL", "AUTOPS", "PSIS",
    "MCHFIN", "AUXFUN", "PREFUN", "SEQNO", "OPSKIP", "LEADER", "DELAY", "DWELL", "STOP", "OPSTOP",
    "CLRSRF", "CLAMP", "SETUP", "HEAD", "PROBE", "VERIFY", "TMARK", "CLDIST", "ARCSLP", "ISN",
    "REWIND", "SWITCH", "SELECTL", "OUTOL", "SEQUENCE", "CALSUB",
    "END-OF-PATH", "END", "FINI", "NOPOST", "CLPRNT", "PRINT", "AIR", "COUPLE", "PPWORD",
})  # fmt: skip
"""Words that do not change the path between two points; some of CHANGES are refused before."""

HOLDING = frozenset({
    "CYCLE", "CUTCOM", "MSYS", "MCS", "TRNTYP", "CSYS", "SET", "MODE", "SPINDL", "MULTAX",
})  # fmt: skip
"""Words that move nothing, but of which something holds for what follows."""

BREAKS = frozenset({"GOHOME", "HOME", "RETRCT", "RAPTO", "LOADTL", "UNLOAD", "TURRET"})
"""Words after which the tool is at an unknown point."""

DIALECTS: dict[str, ArcAxis] = {
    # Siemens NX. Its manual calls the axis that of a clockwise motion.
    "TOOL PATH": "left",
    # CAMWorks. In public files of 41 parts, a straight cut continues a circle without a corner if
    # it is right-handed, but for 42 of 1,900 in three of them; those looked at turn back there.
    "UNIT": "right", "TRNTYP": "right",
    # CAMplete. Autodesk's post keeps the axis for a clockwise motion, and else turns it round.
    "MCS": "left",
    # Creo Manufacturing, CL Output for Circular Interpolation.
    "$$->": "right",
    # ISO 4343. Autodesk's post turns the axis round for a clockwise motion.
    "MOVARC CENTER": "right",
}  # fmt: skip
"""Sense of the motion about a circle's axis, by words, perhaps with an argument, of CAM systems."""


def refuse_change(of: Statement) -> None:
    """Refuse a word that changes the path, unless it is the end of a change or a shift by zero."""
    if of.word in CHANGES and not _changes_nothing(of):
        raise not_read(of.word, CHANGES[of.word])


def _changes_nothing(of: Statement) -> bool:
    if of.word == "OFSTNO":
        return "OFF" in of.arguments
    if of.word == "TRACUT":
        return of.arguments == ["NOMORE"]
    if of.word in ("ORIGIN", "TRANS") and of.arguments:
        numbers = [NUMBER.fullmatch(argument) for argument in of.arguments]
        return all(numbers) and not any(number(of.word, a) for a in of.arguments)
    return False
