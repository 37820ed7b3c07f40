"""Loops of a robot program, as far as the program decides how often they run."""

from __future__ import annotations

import re
from collections.abc import Iterator

from qp_twist.programs.values import Undecided, Unknown, Values


def rounds(
    values: Values,
    line: int,
    role: str,
    match: re.Match[str],
    closing: re.Match[str],
    *,
    counts_down: bool,
) -> Iterator[object]:
    """The rounds of a loop, from the matches of its begin and its end.

    Args:
        values: Of variables.
        line: Of its begin.
        role: What it is.
        match: Of its begin.
        closing: Of its end.
        counts_down: Whether without a step it goes down to a lower end, instead of no round.

    Raises:
        Undecided: If the program does not state whether there is another one.
    """
    if role == "for":
        try:
            first, last = (values.value(match[key]) for key in ("first", "last"))
            groups = match.groupdict()
            down = groups.get("down") or (counts_down and not groups["step"] and first > last)
            step = -1 if down else values.value(groups.get("step") or "1")
            number = int((last - first) // step) + 1 if step else 0
        except (Unknown, TypeError) as error:
            raise Undecided from error
        for k in range(number):
            values.assign(line, match["name"], repr(first + k * step))
            yield k
    elif role in ("while", "until", "for ever"):
        if role == "until":
            yield 0
        end = match if role == "while" else closing
        while role == "for ever" or values.condition(end["condition"]) == (role == "while"):
            yield 0
    else:
        raise Undecided
