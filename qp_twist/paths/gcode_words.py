"""Words of G-code blocks."""

from __future__ import annotations

import re
from dataclasses import dataclass, field

from qp_twist.errors import InvalidInput
from qp_twist.files import shortened
from qp_twist.paths.toolpath import LARGEST_NUMBER

_NUMBER = r"[+-]?(?:[0-9]+\.?[0-9]*|\.[0-9]+)"
_WORD = re.compile(rf"([A-Z])\s*({_NUMBER})")
_ASSIGNED = re.compile(rf"(CR|TURN|[A-Z][0-9]?)\s*=\s*({_NUMBER})(?![A-Z(])")
_PARTS = re.compile(
    r"\"[^\"]*(?:\"|$)|(?:TRAORI|CYCLE832|MSG|WORKPIECE)\s*\([^)]*(?:\)|$)"
    r"|(?P<comment>;.*|\([^)]*(?:\)|(?P<open>$)))",
    re.IGNORECASE,
)
"""Quoted texts, calls, and comments."""
_TOOL_NAME = re.compile(r"(?:T|MSG)\s*(?:=\s*)?\(?\s*\"[^\"]*\"\s*\)?")
_NAMED = re.compile(
    r"TRAORI(?:\s*\(\s*[0-9]*\s*\))?|TRAFOOF|CYCLE832\s*\([^)]*\)|SUPA|"
    r"ORI(?:WKS|MKS|AXES|VECT|PLANE|CURVE)|SOFT|BRISK|FFWO(?:N|F)|COMP(?:CAD|CURV|SURF|ON|OF)|"
    r"UPATH|SPATH|CUT2DF?|CUT3D[A-Z]*|KONT|NORM|FNORM|WORKPIECE\s*\([^)]*\)|DIAMOF|STOPRE"
)
"""Words of SINUMERIK that do not change the path, and those of its five-axis transformation."""


@dataclass(frozen=True)
class Block:
    """A block: one line of a program.

    Attributes:
        words: Values by letter, such as X, or name, such as CR; without G, M, N and O.
        written: The same as they are written.
        codes: G codes, e.g. 1 or 43.4.
        switches: M codes.
        names: Other words.
        skipped: Whether it begins with ``/``.
    """

    words: dict[str, float] = field(default_factory=dict)
    written: dict[str, str] = field(default_factory=dict)
    codes: list[float] = field(default_factory=list)
    switches: list[float] = field(default_factory=list)
    names: list[str] = field(default_factory=list)
    skipped: bool = False


def read_block(line: str) -> Block:
    """The words of a line, without its comments ``( )`` and ``;``.

    Raises:
        InvalidInput: If something in it is neither a word nor a comment, or is there twice.
    """
    text = _without_comments(line).upper().strip()
    if text.startswith(("%", ":")):
        return Block()
    block = Block(skipped=text.startswith("/"))
    at = 1 if block.skipped else 0
    # Block skip has levels: /1 to /9.
    if block.skipped and re.match(r"[1-9](?![0-9.])", text[1:]):
        at = 2
    while at < len(text):
        if text[at].isspace():
            at += 1
            continue
        named = _NAMED.match(text, at) or _TOOL_NAME.match(text, at)
        word = _ASSIGNED.match(text, at) or _WORD.match(text, at)
        if named is not None:
            block.names.append(re.split(r"[\s(=\"]", named[0], maxsplit=1)[0])
            at = named.end()
        elif word is not None:
            _take(block, word[1], word[2])
            at = word.end()
        else:
            raise InvalidInput(
                f"{shortened(text[at:])!r} is not read: expected words such as G1 X10.5; "
                "variables, calculations, branches and subprograms are not computed. Have the CAM "
                "system write plain blocks"
            )
    return block


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
    elif name in block.words:
        raise InvalidInput(f"{name} is there twice")
    else:
        block.words[name] = value
        block.written[name] = text
