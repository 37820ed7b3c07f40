"""Tool axes from the rotary axes of a machine tool."""

from __future__ import annotations

import math
from collections.abc import Sequence
from functools import cache
from typing import Literal

Machine = Literal[
    "head-ac", "head-bc", "head-ab", "head-ba",
    "table-ac", "table-bc", "table-ab", "table-ba",
    "head-a-table-c", "head-b-table-c",
    "table-ac-reversed", "table-bc-reversed", "table-ab-reversed", "table-ba-reversed",
    "head-a-table-c-reversed", "head-b-table-c-reversed",
]  # fmt: skip
"""Where the rotary axes of a machine are, and how they turn."""
Rotary = Literal["vector", Machine]
"""Where the tool axis of a program is from: I, J, K on straight motions, or rotary axes."""
Rollover = Literal["shortest", "as-written"]
"""How a rotary axis turns in a cut by more than 180° and less than a full turn."""
ROLLOVER: Rollover = "shortest"
"""Unless another is chosen."""


def rotary_letters(rotary: Rotary) -> tuple[str, str]:
    """The two letters of a convention, e.g. ``("A", "C")``."""
    words = rotary.removesuffix("-reversed").replace("head", "").replace("table", "")
    letters = words.replace("-", "").upper()
    return letters[0], letters[1]


def begin_of_turn(begin: float, end: float, rollover: Rollover) -> float:
    """Where a turn to ``end`` begins, degrees, so that it turns the way the machine does.

    A rotary axis that rolls over has words within one turn, and takes the short way from 359.8° to
    0.2°. Words beyond ±360°, and differences of a full turn or more, are those of an axis that
    counts its turns; these are turns as written.

    Args:
        begin: Word of the block before, degrees.
        end: Word of the block, degrees.
        rollover: Whether the axis rolls over.
    """
    turn = end - begin
    if rollover == "shortest" and 180.0 < abs(turn) < 360.0 and max(abs(begin), abs(end)) <= 360.0:
        return begin + math.copysign(360.0, turn)
    return begin


def tool_axis(rotary: Rotary, angles: Sequence[float]) -> tuple[float, ...]:
    r"""The tool axis in the part's frame, a unit vector from the tip to the holder, (3,).

    .. math:: \mathbf t = \mathbf R_2(\pm\theta_2)\,\mathbf R_1(\pm\theta_1)\,\mathbf e_z

    with right-handed rotations about x (A), y (B) and z (C). The sign is plus on heads and tables:
    by ISO 841 a positive word turns the tool right-handed relative to the part, so that a table
    (axes A', B', C') turns left-handed. It is minus for a table that itself turns right-handed
    (``-reversed``). The first letter of a convention is the axis next to the tool on a head, and
    the one next to the machine's bed on a table.

    Args:
        rotary: The convention; not ``"vector"``.
        angles: Of the first and the second rotary axis, degrees.
    """
    axis = [0.0, 0.0, 1.0]
    for (k, _, sign), angle in zip(_chain(rotary), angles, strict=True):
        axis = _turned(axis, k, sign * angle)
    return tuple(axis)


def tip(
    machine: Rotary, pivots: Sequence[Sequence[float]], axes: Sequence[float],
    angles: Sequence[float],
) -> list[float]:  # fmt: skip
    r"""The tool's tip in the part's frame, m, where X, Y, Z are positions of the machine's axes.

    .. math:: \mathbf H_i = \mathrm{Trans}(\mathbf p_i)\,\mathbf R_i(\pm\theta_i)\,
        \mathrm{Trans}(-\mathbf p_i)

    On a head, H turns the tip about the pivot p, relative to the tip with all rotary axes at zero;
    on a table, it turns the part's frame, p in the frame of the program. First those of the head,
    then X, Y, Z, then those of the table.

    Args:
        machine: The machine.
        pivots: A point of the first and of the second rotary axis, m, (2, 3).
        axes: X, Y, Z of the block, m.
        angles: Of both rotary axes, degrees.
    """
    found, moved = [0.0, 0.0, 0.0], False
    for (k, on_table, sign), pivot, angle in zip(_chain(machine), pivots, angles, strict=True):
        if on_table and not moved:
            found, moved = [a + b for a, b in zip(found, axes, strict=True)], True
        arm = [a - b for a, b in zip(found, pivot, strict=True)]
        found = [a + b for a, b in zip(_turned(arm, k, sign * angle), pivot, strict=True)]
    return found if moved else [a + b for a, b in zip(found, axes, strict=True)]


@cache
def _chain(rotary: Rotary) -> tuple[tuple[int, bool, float], ...]:
    """Index of the letter, whether it is on the table, and sign of both axes, from the tool on."""
    on_table = rotary.startswith("table"), "table" in rotary
    reverse = -1.0 if rotary.endswith("-reversed") else 1.0
    return tuple(
        ("ABC".index(letter), table, reverse if table else 1.0)
        for letter, table in zip(rotary_letters(rotary), on_table, strict=True)
    )


def _turned(vector: Sequence[float], k: int, angle: float) -> list[float]:
    """A vector turned right-handed about a coordinate axis, degrees."""
    u, v = (k + 1) % 3, (k + 2) % 3
    cos, sin = math.cos(math.radians(angle)), math.sin(math.radians(angle))
    found = list(vector)
    found[u], found[v] = cos * vector[u] - sin * vector[v], sin * vector[u] + cos * vector[v]
    return found
