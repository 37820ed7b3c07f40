"""Tool axes from the rotary axes of a machine tool."""

from __future__ import annotations

from typing import Literal

import mink
import numpy as np

from qp_twist.checks import Array

Rotary = Literal[
    "vector",
    "head-ac", "head-bc", "head-ab", "head-ba",
    "table-ac", "table-bc", "table-ab", "table-ba",
    "head-a-table-c", "head-b-table-c",
]  # fmt: skip
"""Where the tool axis of a program is from: I, J, K on straight motions, or rotary axes."""

_AXES = {"A": (1.0, 0.0, 0.0), "B": (0.0, 1.0, 0.0), "C": (0.0, 0.0, 1.0)}
_HEADS_AND_TABLES: dict[str, tuple[tuple[str, float], tuple[str, float]]] = {
    "head-a-table-c": (("A", 1.0), ("C", -1.0)),
    "head-b-table-c": (("B", 1.0), ("C", -1.0)),
    **{
        f"{kind}-{letters}": ((letters[0].upper(), sign), (letters[1].upper(), sign))
        for kind, sign in (("head", 1.0), ("table", -1.0))
        for letters in ("ac", "bc", "ab", "ba")
    },
}


def rotary_letters(rotary: Rotary) -> tuple[str, str]:
    """The two letters of a convention, e.g. ``("A", "C")``."""
    (first, _), (second, _) = _HEADS_AND_TABLES[rotary]
    return first, second


def tool_axis(rotary: Rotary, angles: dict[str, float]) -> Array:
    r"""The tool axis in the part's frame.

    .. math:: \mathbf t = \mathbf R_2(\pm\theta_2)\,\mathbf R_1(\pm\theta_1)\,\mathbf e_z

    with right-handed rotations about x (A), y (B) and z (C); plus for an axis of the head, which
    turns the tool, and minus for one of the table, which turns the part. The first letter of a
    convention is the axis next to the tool on a head, and the one next to the machine's bed on a
    table.

    Args:
        rotary: The convention; not ``"vector"``.
        angles: Of the rotary axes by letter, degrees.

    Returns:
        Unit vector from the tip to the holder, (3,).
    """
    axis = np.array([0.0, 0.0, 1.0])
    for letter, sign in _HEADS_AND_TABLES[rotary]:
        turn = np.radians(sign * angles[letter]) * np.array(_AXES[letter])
        axis = mink.SO3.exp(turn).apply(axis)
    return axis
