"""Words of G-code blocks."""

from __future__ import annotations

import re

from qp_twist.errors import InvalidInput
from qp_twist.files import shortened
from qp_twist.paths.gcode_tables import CYCLES
from qp_twist.paths.program_block import Block
from qp_twist.paths.program_values import NUMBER

_WORD = re.compile(rf"([A-Z@^])\s*({NUMBER})")
_PLAIN = re.compile(rf"(?:\s*[A-Z]\s*{NUMBER})+\s*")
_ASSIGNED = re.compile(
    rf"(CR|TURN|RNDM?|CHF|CHR|RPL|FRCM?|CTOL|ADIS(?:POS)?|[A-Z][0-9]?)\s*=\s*({NUMBER})(?![A-Z(])"
)
_BY_KIND = re.compile(rf"([XYZABC]|[IJK]1?)\s*=?\s*(AC|IC|DC)\s*\(\s*({NUMBER})\s*\)")
"""SINUMERIK: a coordinate that is absolute or relative, whatever G90 or G91."""
_CORNER = re.compile(rf",\s*([RC])\s*({NUMBER})")
"""FANUC: a corner that is rounded or chamfered."""
CYCLE = r"CYCLE[0-9]+|POCKET[0-9]|SLOT[0-9]|HOLES[0-9]|LONGHOLE"
_CALL = (
    rf"(?:{CYCLE}|TRAORI|MSG|WORKPIECE|GROUP_BEGIN|GROUP_END|TRANSMIT|TRACYL|TRAANG|SETMS|EXTCALL)"
)
_PARTS = re.compile(
    rf"\"[^\"]*(?:\"|$)|{_CALL}\s*\([^)]*(?:\)|$)|(?P<kind>(?:AC|IC|DC)\s*\()"
    r"|(?P<comment>;.*|\((?:[^()]|\([^()]*\))*(?:\)|(?P<open>$)))",
    re.IGNORECASE,
)
"""Quoted texts, calls, and comments."""
_TOOL_NAME = re.compile(r"(?:T|MSG)\s*(?:=\s*)?\(?\s*\"[^\"]*\"\s*\)?")
_NAMED = re.compile(rf"{_CALL}\s*\([^)]*\)|[A-Z_][A-Z_]+[0-9]*[A-Z]*(?![A-Z0-9=(])")
_PASSED = re.compile(
    r"TRAORI|TRAFOOF|CYCLE832|SUPA|ORI(?:WKS|MKS|AXES|VECT|PLANE|CURVE)|SOFT|BRISK|FFWO(?:N|F)|"
    r"COMP(?:CAD|CURV|SURF|ON|OF)|UPATH|SPATH|CUT2DF?|CUT3D[A-Z]*|KONTC?|NORM|FNORM|WORKPIECE|"
    r"DIAMOF|STOPRE|MSG|T|GROUP_(?:BEGIN|END)|SETMS|CFC|CFIN|CFTCP|FIFOCTRL|DYN[A-Z]+|"
    r"RTLIO(?:N|F)|ORISO(?:N|F)|CDO(?:N|F)2?"
)
"""Words of SINUMERIK that do not change the path, and those of its five-axis transformation."""
_REFUSED = {
    "POLY": "a polynomial", "BSPLINE": "a spline", "ASPLINE": "a spline", "CSPLINE": "a spline",
    "INVCW": "an involute", "INVCCW": "an involute",
    "TRANSMIT": "polar interpolation", "TRACYL": "a developed cylinder",
    "TRAANG": "an inclined axis", "AMIRROR": "a mirrored path",
    "ASCALE": "a scaled path", "MIRROR": "a mirrored path", "SCALE": "a scaled path",
    "PRESETON": "a shift of coordinates", "TOFRAME": "turned coordinates",
    "TOROT": "turned coordinates", "ROTS": "turned coordinates", "AROTS": "turned coordinates",
    "EXTCALL": "a call of another program", "REPEAT": "a repeated part of the program",
    "DEF": "a variable", "DIAMON": "a lathe's diameter", "DIAM90": "a lathe's diameter",
}  # fmt: skip
"""Words of SINUMERIK that change it in a way that is not read."""
FRAMES = ("TRANS", "ATRANS", "ROT", "AROT")
"""Words of SINUMERIK after which X, Y, Z are those of another frame."""
ARCS = ("CIP", "CT")
"""Words of SINUMERIK for an arc through a point, and one that continues the motion before."""
_PRINTER = re.compile(
    r"\s*(?:N[0-9]+\s*)?(?:(M(?:7[34]|8[2-7]|92|[1-9][0-9]{2,3})(?:\.[0-9]+)?)(?![0-9])[^;]*?|"
    r"((?:EXCLUDE_OBJECT|SET_|START_PRINT|END_PRINT|PRINT_|TIMELAPSE_|BED_MESH|_?SKEW_|M117|"
    r"SETUP_|CLEAN_NOZZLE|PRIMING|RESPOND|SYNC_|UPDATE_)[A-Z0-9_]*)(?:\s.*)?)\s*(?:;.*)?",
    re.IGNORECASE,
)
"""Lines of 3-D printers with arguments of their own: M201 X500 limits an acceleration."""
_SETTINGS = {
    92, 201, 203, 205, 350, 486, 566, 569, 572, 574, 584, 593, 671, 862.1, 906, 907, 913, 915, 917,
}  # fmt: skip
"""Those among them whose X, Y, Z, A, B, C are settings of these axes (Marlin, RepRapFirmware)."""
_CALLS = {98, 99, 198, 428, 429, 430}
_MOTION = re.compile(r"[XYZABC]\s*[-+.0-9]", re.IGNORECASE)


def read_block(line: str) -> Block:
    """The words of a line, without its comments ``( )`` and ``;``."""
    text, block = line.upper(), Block()
    if ("M" in text or "_" in text) and (printer := _PRINTER.fullmatch(text)) is not None:
        if (name := _of_printer(text, printer)) is not None:
            return Block(names=[name])
    elif _PLAIN.fullmatch(text):
        for name, value in _WORD.findall(text):
            block.take(name, float(value))
        return block
    text = _without_comments(line).upper().strip()
    if text.startswith(("%", ":")):
        return block
    at = 0
    if (skip := re.match(r"/(?:[1-9](?![0-9.]))?", text)) is not None:  # it has levels, /1 to /9
        block.skipped, at = True, skip.end()
    while at < len(text):
        at = at + 1 if text[at].isspace() else _next_word(block, text, at)
    return block


def _of_printer(text: str, found: re.Match[str]) -> str | None:
    """The name of a 3-D printer's line with arguments of its own; ``None`` if it is another."""
    code, words = float(found[1][1:]) if found[1] else 0.0, text.partition(";")[0]
    if code in _CALLS or re.search(r"G[0-9]", words):
        return None
    if found[1] and code not in _SETTINGS and _MOTION.search(words):
        raise InvalidInput(
            f"M{code:g} has coordinates, and what it does with them is not known; take it out if "
            "it moves nothing"
        )
    return f"M{code:g}" if found[1] else found[2]


def _next_word(block: Block, text: str, at: int) -> int:
    """Add the word at a place of a line to a block; where it ends."""
    if (kind := _BY_KIND.match(text, at)) is not None:
        block.take(kind[1], float(kind[3]))
        block.kinds[kind[1]] = kind[2]
        return kind.end()
    if (corner := _CORNER.match(text, at)) is not None:
        block.corner = corner[1], float(corner[2])
        return corner.end()
    named = _TOOL_NAME.match(text, at) or _NAMED.match(text, at)
    if named is not None and _is_name(stem := re.split(r"[\s(=\"]", named[0], maxsplit=1)[0]):
        block.names.append(named[0] if re.fullmatch(CYCLE, stem) else stem)
        return named.end()
    if (word := _ASSIGNED.match(text, at) or _WORD.match(text, at)) is not None:
        block.take(word[1], float(word[2]))
        return word.end()
    raise InvalidInput(
        f"{shortened(text[at:])!r} is not read: expected words such as G1 X10.5; have the CAM "
        "system write plain blocks"
    )


def _is_name(stem: str) -> bool:
    """Whether it is a word of SINUMERIK; one that changes the path otherwise is refused."""
    cycle = re.fullmatch(CYCLE, stem) is not None
    if stem in _REFUSED or (cycle and stem not in CYCLES):
        raise InvalidInput(
            f"{stem} is {_REFUSED.get(stem, 'a cycle of the control')}, which is not read; have "
            "the CAM system write plain motions G0 to G3"
        )
    return cycle or stem in (*FRAMES, *ARCS, "MCALL") or _PASSED.fullmatch(stem) is not None


def _without_comments(line: str) -> str:
    """The line without comments; the text of ``MSG("…")`` is none."""
    parts = list(_PARTS.finditer(line))
    if parts and parts[-1]["open"] is not None:
        raise InvalidInput("the comment has no closing bracket")
    return _PARTS.sub(lambda part: "" if part["comment"] else part[0], line)
