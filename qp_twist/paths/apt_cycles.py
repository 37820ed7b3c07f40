"""Drilling cycles of APT-CL."""

from __future__ import annotations

from collections.abc import Sequence
from collections.abc import Set as AbstractSet
from itertools import zip_longest
from typing import NamedTuple

from qp_twist.errors import InvalidInput
from qp_twist.files import shortened
from qp_twist.paths.apt_statements import Statement, not_read, number
from qp_twist.paths.apt_words import FEED_UNITS

_BORED = frozenset({"DRILL", "DEEP", "DEEP2", "BRKCHP", "CSINK", "FACE", "REAM", "BORE", "THRU"})
"""Cycles that lead the tool along its axis into a hole and back."""
_STATED = frozenset({
    "FEDTO", "RAPTO", "RTRCTO", "DWELL", "STEP", "INCR", "1STPECK", "SUBPECK", "DEPTH", "CLEAR",
})  # fmt: skip
"""What a cycle states, each with a number."""


class Cycle(NamedTuple):
    """A drilling cycle, in the unit of the file.

    Attributes:
        depth: Below each point, along the axis.
        rapid_to: Height above it at which the feed begins.
        retract_to: Height above it at which the tool comes and goes.
        feed: Number and unit, if they are stated.
    """

    depth: float
    rapid_to: float
    retract_to: float
    feed: tuple[float, str] | None


def cycle_of(of: Statement) -> Cycle | None:
    """The cycle that a CYCLE statement begins; ``None`` if it ends one.

    The depth is FEDTO, and the height RAPTO; Creo calls them DEPTH and CLEAR.

    Raises:
        InvalidInput: If it is another cycle, or a value is missing or not known.
    """
    kind = (of.arguments or [""])[0]
    if kind in ("OFF", "CLEAR", "INIT"):
        return None
    if kind not in _BORED:
        raise not_read(f"CYCLE/{kind}", "a cycle")
    values = _by_name(f"CYCLE/{kind}", of.arguments[1:], _STATED | FEED_UNITS.keys())
    if "DEPTH" in values and "FEDTO" not in values:
        values["FEDTO"], values["RAPTO"] = values["DEPTH"], values.get("CLEAR", 0.0)
    if "RAPTO" not in values and "CLEAR" in values and "RTRCTO" not in values:
        values["RAPTO"] = values["CLEAR"]  # beside RTRCTO, CLEAR is an absolute height of CAMplete
    if "FEDTO" not in values or "RAPTO" not in values:
        raise InvalidInput(f"CYCLE/{kind}: expected FEDTO and RAPTO, each with a distance")
    feeds = [(values[unit], unit) for unit in FEED_UNITS if unit in values]
    rapid_to = values["RAPTO"]
    # FEDTO is a depth, in some systems with a minus; the tool does not go further out than in.
    above = max(values.get("RTRCTO", rapid_to), rapid_to)
    return Cycle(abs(values["FEDTO"]), rapid_to, above, feeds[0] if feeds else None)


def _by_name(word: str, words: Sequence[str], names: AbstractSet[str]) -> dict[str, float]:
    """Numbers by the name before each.

    Raises:
        InvalidInput: If a name is another one, or no number follows it.
    """
    found: dict[str, float] = {}
    for name, text in zip_longest(words[::2], words[1::2], fillvalue=""):
        if name in _BORED:  # a second word of the kind, as in DRILL, DEEP
            return _by_name(word, [other for other in words if other != name], names)
        if name not in names:
            raise InvalidInput(f"{word}: {shortened(name)!r} is not known in a cycle")
        if (name, text) != ("RTRCTO", "AUTO"):  # back to where the feed begins, or further
            found[name] = number(f"{word}, {name}", text)
    return found
