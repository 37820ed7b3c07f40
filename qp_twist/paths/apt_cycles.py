"""Drilling cycles of APT-CL."""

from __future__ import annotations

from collections.abc import Sequence
from collections.abc import Set as AbstractSet
from itertools import zip_longest

from qp_twist.errors import InvalidInput
from qp_twist.files import shortened
from qp_twist.paths.apt_statements import Statement, not_read, number
from qp_twist.paths.apt_units import FEED_UNITS
from qp_twist.paths.machine_tool import Hole

_BORED = frozenset({"DRILL", "DEEP", "DEEP2", "BRKCHP", "CSINK", "FACE", "REAM", "BORE", "THRU"})
"""Cycles that lead the tool along its axis into a hole and back."""
_STATED = frozenset({
    "FEDTO", "RAPTO", "RTRCTO", "DWELL", "STEP", "INCR", "1STPECK", "SUBPECK", "DEPTH", "CLEAR",
})  # fmt: skip
"""What a cycle states, each with a number."""


def cycle_of(of: Statement) -> tuple[Hole | None, tuple[float, str] | None]:
    """The hole of a CYCLE statement, and its feed and the unit of it; none if it ends one.

    Heights are those above each point, in the unit of the file.
    The depth is FEDTO, and the height RAPTO; Creo calls them DEPTH and CLEAR.

    Raises:
        InvalidInput: If it is another cycle, or a value is missing or not known.
    """
    kind = (of.arguments or [""])[0]
    if kind in ("OFF", "CLEAR", "INIT"):
        return None, None
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
    return Hole(rapid_to, -abs(values["FEDTO"]), above), feeds[0] if feeds else None


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
