"""Corners between two straight cuts, rounded or chamfered."""

from __future__ import annotations

import math

import numpy as np

from qp_twist.checks import Array
from qp_twist.errors import InvalidInput
from qp_twist.paths.arcs import Arc
from qp_twist.paths.gcode_words import Block

_STRAIGHT = 1e-9
"""Cuts that turn by less than this angle, rad, have no corner."""


def corner_of(block: Block) -> tuple[str, float] | None:
    """Kind and size of the corner at the end of a block.

    ``,R`` and RND: its radius. ``,C`` and CHR: what the chamfer takes of each cut. CHF: the length
    of the chamfer (FANUC, *Chamfering and corner R*; SINUMERIK, *Chamfer, rounding*).

    Raises:
        InvalidInput: If it has several, or one below 0.
    """
    sinumerik = {"RND": "R", "CHR": "C", "CHF": "CHF"}
    found = [(kind, block.words[word]) for word, kind in sinumerik.items() if word in block.words]
    found += [] if block.corner is None else [block.corner]
    if len(found) > 1 or any(size < 0.0 for _, size in found):
        raise InvalidInput("expected one corner, of a size of at least 0")
    return found[0] if found and found[0][1] else None


def cut_corner(
    before: Array, corner: Array, after: Array, kind: str, size: float
) -> tuple[Array, Arc | Array | None]:
    r"""Where a corner between two straight cuts is left, and the motion that cuts it.

    A rounding of radius r leaves the cuts :math:`r \tan(\varphi/2)` before and after the corner, φ
    being the angle by which the path turns there.

    Returns:
        The point at which the first cut ends, (3,); the arc, or the end of the chamfer, (3,), or
        nothing if the cuts are in line.

    Raises:
        InvalidInput: If a cut is too short for it.
    """
    lengths = [float(np.linalg.norm(end - corner)) for end in (before, after)]
    if min(lengths) < _STRAIGHT:
        raise InvalidInput("a corner is cut between two motions, and one of them has no length")
    u, v = (before - corner) / lengths[0], (after - corner) / lengths[1]
    turn = math.pi - math.atan2(float(np.linalg.norm(np.cross(u, v))), float(u @ v))
    if turn < _STRAIGHT:
        return corner, None
    if math.pi - turn < 1e-6:
        raise InvalidInput("a corner is cut where the path goes back, which leaves it open")
    back = {
        "R": size * math.tan(0.5 * turn), "C": size, "CHF": 0.5 * size / math.cos(0.5 * turn),
    }[kind]  # fmt: skip
    if back > min(lengths) * (1.0 + 1e-9):
        raise InvalidInput(
            f"the corner takes {1e3 * back:.6g} mm of cuts that are {1e3 * lengths[0]:.6g} mm and "
            f"{1e3 * lengths[1]:.6g} mm long"
        )
    start, end = corner + back * u, corner + back * v
    if kind != "R":
        return start, end
    axis = np.cross(v, u)
    axis /= np.linalg.norm(axis)
    # From start to end the path turns from -u to v, right-handed about (-u) × v.
    centre = start + size * np.cross(axis, -u)
    return start, Arc.between(start, end, centre, axis)
