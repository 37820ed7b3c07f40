"""Blocks and words of Klartext, the conversational programs of Heidenhain controls."""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field

from qp_twist.errors import InvalidInput
from qp_twist.files import shortened
from qp_twist.paths.toolpath import LARGEST_NUMBER

BEGIN = re.compile(r"\s*[0-9]*\s*BEGIN\s+PGM\b(?:.*?\b(?P<unit>MM|INCH)\s*$)?", re.IGNORECASE)
"""The first block of a program, with its unit."""
_NUMBER = re.compile(r"[+-]?(?:[0-9]+\.?[0-9]*|\.[0-9]+)")
_VALUE = r"[+-]?\s*(?:Q[LR]?[0-9]+|[0-9]+[.,]?[0-9]*|[.,][0-9]+)"
_WORDS = re.compile(
    # F after M103 and M128 is not that of the path, and M140 and M120 have words of their own.
    rf"\s*(?:(?P<own>M(?:103|128)(?:\s*F\s*(?:MAX|{_VALUE}))?|M140(?:\s*MB\s*(?:MAX|{_VALUE}))?"
    rf"(?:\s*F\s*(?:MAX|{_VALUE}))?|M120(?:\s*LA\s*{_VALUE})?)(?![0-9])"
    r"|DR\s*(?P<sense>[+-])(?![0-9])|(?P<side>R[0LR+-])(?![0-9.,])|F\s*(?P<feed>MAX|AUTO)\b"
    r"|(?P<name>I?[XYZABCUVW]|I?P[RA]|[NT][XYZ]|SP[ABC]|CCA|LEN|FU|FZ|FT|F|M|S|R)\s*"
    rf"(?P<value>{_VALUE}))"
)
_KEYWORD = re.compile(
    r"(?P<two>(?:BEGIN|END|CALL) PGM|BLK FORM|TOOL (?:CALL|DEF)|CYCL (?:DEF|CALL|END)|CALL LBL"
    r"|TCH PROBE)(?![A-Z])|(?P<group>FN(?= ?[0-9])|Q(?=[LRS]?[0-9]+ *=)|APPR\b|DEP\b|RND(?![A-Z])"
    r"|CHF(?![A-Z]))|[A-Z]+|\*"
)
"""With which a block begins."""


NO_MOTION = ("BLK FORM", "TOOL DEF", "STOP", "*", "CYCL END", "LBL")
"""Blocks that move nothing."""


@dataclass(frozen=True)
class Block:
    """A block, its continuations included.

    Attributes:
        line: Of the file, from 1.
        keyword: With which it begins, e.g. ``L`` or ``CYCL DEF``; empty if it has words alone.
        text: What follows, in capitals, without comments.
        skipped: Whether it begins with ``/``.
    """

    line: int
    keyword: str
    text: str
    skipped: bool


@dataclass
class Words:
    """Words of a block.

    Attributes:
        values: Numbers by name: X, IX, PR, NX, F, …
        switches: M functions.
        sense: 1 for DR+, -1 for DR-, 0 without.
        rapid: Whether it has FMAX.
        corrected: Whether it has RL or RR.
    """

    values: dict[str, float] = field(default_factory=dict)
    switches: list[int] = field(default_factory=list)
    sense: int = 0
    rapid: bool = False
    corrected: bool = False


def blocks(lines: Sequence[str]) -> Iterator[Block]:
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
                yield _block(begun, text)
            text, begun = bare.replace("CYCLE DEF", "CYCL DEF"), k
        goes_on = line.rstrip().endswith("~")


def _block(line: int, text: str) -> Block:
    skipped, bare = re.fullmatch(r"(/? ?[0-9]* ?/?) ?(.*)", text).groups()  # type: ignore[union-attr]
    match = _KEYWORD.match(bare)
    keyword = "" if match is None or match[0] in ("F", "M", "S") else match[0]
    return Block(line, keyword, bare[len(keyword) :].strip(), "/" in skipped)


def words(text: str, parameters: Mapping[str, float]) -> Words:
    """The words of a block.

    Args:
        text: After its keyword.
        parameters: Values of Q parameters.

    Raises:
        InvalidInput: If something in it is no word, is there twice, or a parameter has no value.
    """
    found, at, text = Words(), 0, text.rstrip()
    while at < len(text):
        match = _WORDS.match(text, at)
        if match is None:
            raise InvalidInput(f"{shortened(text[at:].strip())!r} is not read")
        at = match.end()
        if match["own"]:
            found.switches.append(int(match["own"][1:4]))
        elif match["sense"]:
            found.sense = 1 if match["sense"] == "+" else -1
        elif match["side"]:
            found.corrected |= match["side"] != "R0"
        elif match["feed"]:
            found.rapid |= match["feed"] == "MAX"
        elif match["name"] == "M":
            found.switches.append(int(number(match["value"], parameters)))
        elif match["name"] in found.values:
            raise InvalidInput(f"{match['name']} is there twice")
        else:
            found.values[match["name"]] = number(match["value"], parameters)
    return found


def number(text: str, parameters: Mapping[str, float]) -> float:
    """A number, with a decimal point or comma, or the value of a Q parameter.

    Raises:
        InvalidInput: If it is none, is too large, or the parameter has no value.
    """
    bare = text.replace(" ", "").replace(",", ".")
    if _NUMBER.fullmatch(bare):
        value = float(bare)
        if not abs(value) <= LARGEST_NUMBER:
            raise InvalidInput(f"{shortened(text)!r} is too large")
        return value
    name = bare.lstrip("+-")
    if not name.startswith("Q"):
        raise InvalidInput(f"expected a number, got {shortened(text)!r}")
    if name not in parameters:
        raise InvalidInput(
            f"{name} has no value that is known here: calculated parameters, those of tables "
            "and of measurements are not read; have the CAM system write numbers"
        )
    return -parameters[name] if bare.startswith("-") else parameters[name]
