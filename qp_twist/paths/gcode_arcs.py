"""Centres of the arcs of G-code."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from qp_twist.checks import Array
from qp_twist.errors import InvalidInput
from qp_twist.paths.arcs import centre_of_radius, check_radii
from qp_twist.paths.gcode_cycles import Modes
from qp_twist.paths.gcode_words import Block

_PLANES: dict[float, tuple[str, str, str]] = {
    17: ("X", "Y", "Z"), 18: ("Z", "X", "Y"), 19: ("Y", "Z", "X"),
}  # fmt: skip
"""The two axes of each plane, and the one about which G3 is right-handed."""
_CENTRE = {"X": "I", "Y": "J", "Z": "K"}


def axis_of(modes: Modes) -> Array:
    """The axis about which an arc is right-handed: G2 left-handed, G3 right-handed, (3,)."""
    axis = np.array([float(name == _PLANES[modes.plane][2]) for name in "XYZ"])
    return -axis if modes.motion == 2 else axis


def centre_of(
    block: Block, ends: tuple[Array, Array], scale: float, modes: Modes,
    note: Callable[[str], None],
) -> Array:  # fmt: skip
    """The centre of an arc, m, (3,), by I, J, K or by its radius.

    Args:
        block: Its block.
        ends: Its first and last point, m, (3,).
        scale: Metres in the unit of the block.
        modes: What holds; that centres are absolute is noted there, if only this fits.
        note: What notes an assumption.

    Raises:
        InvalidInput: If the block states none, or several.
    """
    (start, end), axis = ends, axis_of(modes)
    words = block.words
    radius = words.get("R", words.get("CR"))
    letters = [_CENTRE[name] for name in _PLANES[modes.plane][:2]]
    named = [letter for letter in "IJK" if letter in words]
    if radius is not None and any(words[letter] for letter in named):
        raise InvalidInput("an arc has a radius R or a centre I, J, K; got both")
    if radius is not None:
        return centre_of_radius(start, end, axis, scale * radius)
    in_plane = f"an arc in the plane of G{modes.plane} has its centre in "
    if not set(named) & set(letters):
        raise InvalidInput(f"{in_plane}{' and '.join(letters)}, or a radius R; got neither")
    if any(words[letter] for letter in named if letter not in letters):
        raise InvalidInput(f"{in_plane}{' and '.join(letters)} alone; got {', '.join(named)}")
    if modes.absolute_centres and not set(letters) <= set(named):
        raise InvalidInput(f"G90.1: the centre needs both {' and '.join(letters)}")
    stated = np.array([scale * words.get(letter, 0.0) for letter in "IJK"])
    if block.kinds.keys() & set(letters):
        absolute = {k for k, kind in block.kinds.items() if kind == "AC"}
        mixed = [k in absolute for k in "IJK"]
        return np.where(mixed, stated, start + stated)
    fits = _fits(start, end, start + stated, axis)
    if modes.absolute_centres is None and not fits and stated.any():
        # Some controls count I, J, K from the origin without a word: if only that fits, so.
        if not _fits(start, end, stated, axis) or not set(letters) <= set(named):
            check_radii(start, end, start + stated, axis, None)
        modes.absolute_centres = True
        note("the centres I, J, K of arcs are absolute: from the start, none would fit")
    centre: Array = stated if modes.absolute_centres else start + stated
    return centre


def _fits(start: Array, end: Array, centre: Array, axis: Array) -> bool:
    """Whether a point can be the centre of an arc."""
    try:
        check_radii(start, end, centre, axis, None)
    except InvalidInput:
        return False
    return True
