"""Words for parts that are left out, and why."""

from __future__ import annotations

from collections.abc import Sequence

_SHOWN = 3


def listed(noun: str, names: Sequence[str]) -> str:
    """For example ``joint 'a'``, or ``5 joints ('a', 'b', 'c' …)``."""
    if len(names) == 1:
        return f"{noun} {names[0]!r}"
    shown = ", ".join(repr(name) for name in names[:_SHOWN])
    plural = noun + ("es" if noun.endswith("sh") else "s")
    return f"{len(names)} {plural} ({shown}{' …' if len(names) > _SHOWN else ''})"


def reason_of(error: ValueError) -> str:
    """What MuJoCo says is wrong, on one line."""
    return " ".join(str(error).split()).removeprefix("Error: ")
