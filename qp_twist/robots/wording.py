"""Words for parts that are left out, and why; free names."""

from __future__ import annotations

import itertools
from collections.abc import Collection, Sequence

_SHOWN = 3


def listed(noun: str, names: Sequence[str]) -> str:
    """For example ``joint 'a'``, or ``5 joints ('a', 'b', 'c' …)``."""
    if len(names) == 1:
        return f"{noun} {names[0]!r}"
    shown = ", ".join(repr(name) for name in names[:_SHOWN])
    plural = noun + ("es" if noun.endswith("sh") else "s")
    return f"{len(names)} {plural} ({shown}{' …' if len(names) > _SHOWN else ''})"


def reason_of(error: Exception) -> str:
    """What MuJoCo, or the reader of a file, says is wrong, on one line."""
    return " ".join(str(error).split()).removeprefix("Error: ") or type(error).__name__


def free_name(name: str, taken: Collection[str]) -> str:
    """The name, numbered from 2 if it is taken."""
    names = itertools.chain([name], (f"{name}_{count}" for count in itertools.count(2)))
    return next(free for free in names if free not in taken)
