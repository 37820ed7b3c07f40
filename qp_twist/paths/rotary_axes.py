"""Tool axes from the rotary axes of a machine tool."""

from __future__ import annotations

import math
from typing import Literal

import mink
import numpy as np

from qp_twist.checks import Array

Rotary = Literal[
    "vector",
    "head-ac", "head-bc", "head-ab", "head-ba",
    "table-ac", "table-bc", "table-ab", "table-ba",
    "head-a-table-c", "head-b-table-c",
    "table-ac-reversed", "table-bc-reversed", "table-ab-reversed", "table-ba-reversed",
    "head-a-table-c-reversed", "head-b-table-c-reversed",
]  # fmt: skip
"""Where the tool axis of a program is from: I, J, K on straight motions, or rotary axes."""
Rollover = Literal["shortest", "as-written"]
"""How a rotary axis turns in a cut by more than 180° and less than a full turn."""
ROLLOVER: Rollover = "shortest"
"""Unless another is chosen."""

_AXES = {"A": (1.0, 0.0, 0.0), "B": (0.0, 1.0, 0.0), "C": (0.0, 0.0, 1.0)}


def rotary_letters(rotary: Rotary) -> tuple[str, str]:
    """The two letters of a convention, e.g. ``("A", "C")``."""
    words = [word for word in rotary.split("-") if word not in ("head", "table", "reversed")]
    letters = "".join(words).upper()
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


def tool_axis(rotary: Rotary, angles: dict[str, float]) -> Array:
    r"""The tool axis in the part's frame.

    .. math:: \mathbf t = \mathbf R_2(\pm\theta_2)\,\mathbf R_1(\pm\theta_1)\,\mathbf e_z

    with right-handed rotations about x (A), y (B) and z (C). The sign is plus on heads and tables:
    by ISO 841 a positive word turns the tool right-handed relative to the part, so that a table
    (axes A', B', C') turns left-handed. It is minus for a table that itself turns right-handed
    (``-reversed``). The first letter of a convention is the axis next to the tool on a head, and
    the one next to the machine's bed on a table.

    Args:
        rotary: The convention; not ``"vector"``.
        angles: Of the rotary axes by letter, degrees.

    Returns:
        Unit vector from the tip to the holder, (3,).
    """
    axis = np.array([0.0, 0.0, 1.0])
    first, second = rotary_letters(rotary)
    reversed_table = rotary.endswith("-reversed")
    for letter, on_table in ((first, rotary.startswith("table")), (second, "table" in rotary)):
        sign = -1.0 if reversed_table and on_table else 1.0
        turn = np.radians(sign * angles[letter]) * np.array(_AXES[letter])
        axis = mink.SO3.exp(turn).apply(axis)
    return axis
