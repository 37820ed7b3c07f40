"""Words of G-code blocks."""

from __future__ import annotations

import re
from dataclasses import dataclass, field

from qp_twist.errors import InvalidInput
from qp_twist.files import shortened
from qp_twist.paths.toolpath import LARGEST_NUMBER

NUMBER = r"[+-]?(?:[0-9]+\.?[0-9]*|\.[0-9]+)"
NUMBER_PATTERN = re.compile(NUMBER)
_WORD = re.compile(rf"([A-Z])\s*({NUMBER})")
_PLAIN = re.compile(rf"(?:\s*[A-Z]\s*{NUMBER})+\s*")
_ASSIGNED = re.compile(
    rf"(CR|TURN|RNDM?|CHF|CHR|RPL|FRCM?|CTOL|[A-Z][0-9]?)\s*=\s*({NUMBER})(?![A-Z(])"
)
_BY_KIND = re.compile(rf"([XYZABCIJK])\s*=?\s*(AC|IC|DC)\s*\(\s*({NUMBER})\s*\)")
"""SINUMERIK: a coordinate that is absolute or relative, whatever G90 or G91."""
_CORNER = re.compile(rf",\s*([RC])\s*({NUMBER})")
"""FANUC: a corner that is rounded or chamfered."""
_CYCLE = r"CYCLE[0-9]+|POCKET[0-9]|SLOT[0-9]|HOLES[0-9]|LONGHOLE"
_CALL = (
    rf"(?:{_CYCLE}|TRAORI|MSG|WORKPIECE|GROUP_BEGIN|GROUP_END|TRANSMIT|TRACYL|TRAANG|SETMS|EXTCALL)"
)
_PARTS = re.compile(
    rf"\"[^\"]*(?:\"|$)|{_CALL}\s*\([^)]*(?:\)|$)|(?P<kind>(?:AC|IC|DC)\s*\()"
    r"|(?P<comment>;.*|\((?:[^()]|\([^()]*\))*(?:\)|(?P<open>$)))",
    re.IGNORECASE,
)
"""Quoted texts, calls, and comments."""
_TOOL_NAME = re.compile(r"(?:T|MSG)\s*(?:=\s*)?\(?\s*\"[^\"]*\"\s*\)?")
_NAMED = re.compile(rf"{_CALL}\s*\([^)]*\)|[A-Z_][A-Z_]+[0-9]*[A-Z]*(?![A-Z0-9=(])")
PASSED_NAMES = re.compile(
    r"TRAORI|TRAFOOF|CYCLE832|SUPA|ORI(?:WKS|MKS|AXES|VECT|PLANE|CURVE)|SOFT|BRISK|FFWO(?:N|F)|"
    r"COMP(?:CAD|CURV|SURF|ON|OF)|UPATH|SPATH|CUT2DF?|CUT3D[A-Z]*|KONTC?|NORM|FNORM|WORKPIECE|"
    r"DIAMOF|STOPRE|MSG|T|GROUP_(?:BEGIN|END)|SETMS|CFC|CFIN|CFTCP|FIFOCTRL|DYN[A-Z]+|"
    r"RTLIO(?:N|F)|ORISO(?:N|F)|CDO(?:N|F)2?"
)
"""Words of SINUMERIK that do not change the path, and those of its five-axis transformation."""
REFUSED_NAMES = {
    "POLY": "a polynomial", "BSPLINE": "a spline", "ASPLINE": "a spline", "CSPLINE": "a spline",
    "CIP": "an arc through a point", "CT": "a tangential arc", "INVCW": "an involute",
    "INVCCW": "an involute", "TRANSMIT": "polar interpolation", "TRACYL": "a developed cylinder",
    "TRAANG": "an inclined axis", "MCALL": "a cycle at each position", "AMIRROR": "a mirrored path",
    "ASCALE": "a scaled path", "MIRROR": "a mirrored path", "SCALE": "a scaled path",
    "PRESETON": "a shift of coordinates", "TOFRAME": "turned coordinates",
    "TOROT": "turned coordinates", "ROTS": "turned coordinates", "AROTS": "turned coordinates",
    "EXTCALL": "a call of another program", "REPEAT": "a repeated part of the program",
    "DEF": "a variable", "DIAMON": "a lathe's diameter", "DIAM90": "a lathe's diameter",
}  # fmt: skip
"""Words of SINUMERIK that change it in a way that is not read."""
FRAMES = ("TRANS", "ATRANS", "ROT", "AROT", "CYCLE800")
"""Words of SINUMERIK after which X, Y, Z are those of another frame."""
_PRINTER = re.compile(
    r"\s*(?:N[0-9]+\s*)?(?:(M(?:73|8[2-7]|92|[1-9][0-9]{2,3})(?:\.[0-9]+)?)(?![0-9])[^;(]*?|"
    r"((?:EXCLUDE_OBJECT|SET_|START_PRINT|END_PRINT|PRINT_|TIMELAPSE_|BED_MESH|_?SKEW_|M117|"
    r"SETUP_|CLEAN_NOZZLE|PRIMING|RESPOND|SYNC_|UPDATE_)[A-Z0-9_]*)(?:\s.*)?)\s*(?:;.*)?",
    re.IGNORECASE,
)
"""Lines of 3-D printers with arguments of their own: M201 X500 limits an acceleration."""
_SETTINGS = {92, 201, 203, 205, 350, 566, 569, 572, 574, 584, 593, 671, 906, 907, 913, 915, 917}
"""Those among them whose X, Y, Z, A, B, C are settings of these axes (Marlin, RepRapFirmware)."""
_CALLS = {98, 99, 198, 428, 429, 430}
_MOTION = re.compile(r"[XYZABC]\s*[-+.0-9]", re.IGNORECASE)


@dataclass(slots=True)
class Block:
    """A block: one line of a program.

    Attributes:
        words: Values by letter, such as X, or name, such as CR; without G and M.
        written: The same as they are written.
        codes: G codes, e.g. 1 or 43.4.
        switches: M codes.
        names: Other words, and calls with their arguments, e.g. ``CYCLE800()``.
        kinds: Coordinates that are absolute (AC) or relative (IC) by themselves.
        corner: How the corner at its end is cut, e.g. ``("R", 2.0)``.
        skipped: Whether it begins with ``/``.
    """

    words: dict[str, float] = field(default_factory=dict)
    written: dict[str, str] = field(default_factory=dict)
    codes: list[float] = field(default_factory=list)
    switches: list[float] = field(default_factory=list)
    names: list[str] = field(default_factory=list)
    kinds: dict[str, str] = field(default_factory=dict)
    corner: tuple[str, float] | None = None
    skipped: bool = False

    @property
    def empty(self) -> bool:
        """Whether it has no word."""
        return not (self.words or self.codes or self.switches or self.names or self.skipped)


def read_block(line: str) -> Block:
    """The words of a line, without its comments ``( )`` and ``;``.

    Raises:
        InvalidInput: If something in it is neither a word nor a comment, or is there twice.
    """
    text = line.upper()
    printer = _PRINTER.fullmatch(text) if "M" in text or "_" in text else None
    if printer is not None and (found := _of_printer(text, printer)) is not None:
        return found
    block = Block()
    if _PLAIN.fullmatch(text):
        for name, value in _WORD.findall(text):
            _take(block, name, value)
        return block
    text = _without_comments(line).upper().strip()
    if text.startswith(("%", ":")):
        return block
    block.skipped = text.startswith("/")
    at = 1 if block.skipped else 0
    # Block skip has levels: /1 to /9.
    if block.skipped and re.match(r"[1-9](?![0-9.])", text[1:]):
        at = 2
    while at < len(text):
        if text[at].isspace():
            at += 1
            continue
        at = _next_word(block, text, at)
    return block


def _of_printer(text: str, found: re.Match[str]) -> Block | None:
    """The block of a 3-D printer's line with arguments of its own; ``None`` if it is another."""
    code = float(found[1][1:]) if found[1] else 0.0
    if code in _CALLS or re.search(r"G[0-9]", text.partition(";")[0]):
        return None
    if found[1] and code not in _SETTINGS and _MOTION.search(text.partition(";")[0]):
        raise InvalidInput(
            f"M{code:g} has coordinates, and what it does with them is not known; take it out if "
            "it moves nothing"
        )
    return Block(names=[f"M{code:g}" if found[1] else found[2]])


def _next_word(block: Block, text: str, at: int) -> int:
    """Add the word at a place of a line to a block; where it ends."""
    if (kind := _BY_KIND.match(text, at)) is not None:
        _take(block, kind[1], kind[3])
        block.kinds[kind[1]] = kind[2]
        return kind.end()
    if (corner := _CORNER.match(text, at)) is not None:
        block.corner = corner[1], float(corner[2])
        return corner.end()
    named = _TOOL_NAME.match(text, at) or _NAMED.match(text, at)
    if named is not None and _known(named[0]):
        block.names.append(named[0] if "CYCLE800" in named[0] else _stem(named[0]))
        return named.end()
    if (word := _ASSIGNED.match(text, at) or _WORD.match(text, at)) is not None:
        _take(block, word[1], word[2])
        return word.end()
    raise InvalidInput(
        f"{shortened(text[at:])!r} is not read: expected words such as G1 X10.5; have the CAM "
        "system write plain blocks"
    )


def _stem(text: str) -> str:
    return re.split(r"[\s(=\"]", text, maxsplit=1)[0]


def is_cycle(stem: str) -> bool:
    """Whether a word is a machining cycle of a SINUMERIK."""
    return re.fullmatch(_CYCLE, stem) is not None


def _known(text: str) -> bool:
    stem = _stem(text)
    passed = PASSED_NAMES.fullmatch(stem) is not None or is_cycle(stem)
    return passed or stem in FRAMES or stem in REFUSED_NAMES


def _without_comments(line: str) -> str:
    """The line without comments; the text of ``MSG("…")`` is none."""
    parts = list(_PARTS.finditer(line))
    if parts and parts[-1]["open"] is not None:
        raise InvalidInput("the comment has no closing bracket")
    return _PARTS.sub(lambda part: "" if part["comment"] else part[0], line)


def _take(block: Block, name: str, text: str) -> None:
    value = float(text)
    if not abs(value) <= LARGEST_NUMBER:
        raise InvalidInput(f"{name}: {text[:40]!r}… is too large")
    if name == "G":
        block.codes.append(value)
    elif name == "M":
        block.switches.append(value)
    elif name in block.words and name != "T":  # the tool, and the next one
        raise InvalidInput(f"{name} is there twice")
    else:
        block.words[name] = value
        block.written[name] = text
