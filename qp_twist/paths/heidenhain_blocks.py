"""Lines and words of Klartext, the conversational programs of Heidenhain controls."""

from __future__ import annotations

import re
from collections.abc import Iterator, Sequence
from typing import NamedTuple

from qp_twist.errors import InvalidInput
from qp_twist.files import shortened
from qp_twist.paths.program_block import Block
from qp_twist.paths.program_values import Variables
from qp_twist.paths.toolpath import LARGEST_NUMBER

BEGIN = re.compile(r"\s*[0-9]*\s*BEGIN\s+PGM\b(?:.*?\b(?P<unit>MM|INCH)\s*$)?", re.IGNORECASE)
"""The first block of a program, with its unit."""
_NUMBER = re.compile(r"[+-]?(?:[0-9]+\.?[0-9]*|\.[0-9]+)")
_VALUE = r"[+-]?\s*(?:Q[LR]?[0-9]+|[0-9]+[.,]?[0-9]*|[.,][0-9]+)"
_WORDS = re.compile(
    # F after M103 and M128 is not that of the path, and M140 and M120 have words of their own.
    rf"\s*(?:(?P<own>M(?:103|128)(?:\s*F\s*(?:MAX|{_VALUE}))?|M140(?:\s*MB\s*(?:MAX|{_VALUE}))?"
    rf"(?:\s*F\s*(?:MAX|{_VALUE}))?|M120(?:\s*LA\s*{_VALUE})?)(?![0-9])"
    r"|(?P<flag>DR\s*[+-](?![0-9])|R[0LR+-](?![0-9.,])|F\s*(?:MAX|AUTO)\b)"
    r"|(?P<name>I?[XYZABCUVW]|I?P[RA]|[NT][XYZ]|SP[ABC]|CCA|LEN|FU|FZ|FT|F|M|S|R)\s*"
    rf"(?P<value>{_VALUE}))"
)
_KEYWORD = re.compile(
    r"(?P<two>(?:BEGIN|END|CALL) PGM|BLK FORM|TOOL (?:CALL|DEF)|CYCL (?:DEF|CALL|END)|CALL LBL"
    r"|TCH PROBE)(?![A-Z])|(?P<group>FN(?= ?[0-9])|Q(?=[LRS]?[0-9]+ *=)|APPR\b|DEP\b|RND(?![A-Z])"
    r"|CHF(?![A-Z]))|[A-Z]+|\*"
)
"""With which a block begins."""


class Line(NamedTuple):
    """A block as it is written, its continuations included.

    Attributes:
        number: Of its line in the file, from 1.
        keyword: With which it begins, e.g. ``L`` or ``CYCL DEF``; empty if it has words alone.
        text: What follows, in capitals, without comments.
        skipped: Whether it begins with ``/``.
    """

    number: int
    keyword: str
    text: str
    skipped: bool


def blocks(lines: Sequence[str]) -> Iterator[Line]:
    """The blocks from BEGIN PGM on; ``~`` continues one, ``;`` begins a comment."""
    text, begun, goes_on = "", 0, False
    first = next((k for k, line in enumerate(lines) if BEGIN.match(line)), 0)
    for k, line in enumerate([*lines[first:], ""], start=first + 1):
        # Brackets are comments of some simulators, but not behind the = of a formula.
        notes = ";.*" if "=" in line.partition("(")[0] else r"\([^()]*\)|;.*"
        bare = re.sub(r"\s+", " ", re.sub(notes, "", line).upper()).strip(" ~")
        # Parameters of a cycle continue it with and without ~.
        if text and (goes_on or (text.startswith("CYCL DEF") and re.match("Q[0-9]+ ?=", bare))):
            text += f" {bare}"
        else:
            if text:
                yield _line(begun, text)
            text, begun = bare.replace("CYCLE DEF", "CYCL DEF"), k
        goes_on = line.rstrip().endswith("~")


def _line(number: int, text: str) -> Line:
    skipped, bare = re.fullmatch(r"(/? ?[0-9]* ?/?) ?(.*)", text).groups()  # type: ignore[union-attr]
    match = _KEYWORD.match(bare)
    keyword = "" if match is None or match[0] in ("F", "M", "S") else match[0]
    return Line(number, keyword, bare[len(keyword) :].strip(), "/" in skipped)


def words(text: str, values: Variables) -> Block:
    """The words of a block: IX is X, which is relative; DR is 1 or -1; FMAX, RL, … are names.

    Args:
        text: After its keyword.
        values: Of Q parameters.
    """
    found, at, text = Block(), 0, text.rstrip()
    while at < len(text):
        match = _WORDS.match(text, at)
        if match is None:
            raise InvalidInput(f"{shortened(text[at:].strip())!r} is not read")
        at, name = match.end(), match["name"]
        if match["own"]:
            found.switches.append(int(match["own"][1:4]))
        elif match["flag"]:
            flag = match["flag"].replace(" ", "")
            found.names.append(flag)
            if flag[0] == "D":
                found.words["DR"] = float(f"{flag[2]}1")
        elif name[0] == "I":
            found.take(name[1:], number(match["value"], values))
            found.kinds[name[1:]] = "IC"
        else:
            found.take(name, number(match["value"], values))
    return found


def number(text: str, values: Variables) -> float:
    """A number, with a decimal point or comma, or the value of a Q parameter."""
    bare = text.replace(" ", "").replace(",", ".")
    found = float(bare) if _NUMBER.fullmatch(bare) else values.value(bare)
    if not abs(found) <= LARGEST_NUMBER:
        raise InvalidInput(f"{shortened(text)!r} is too large")
    return found
