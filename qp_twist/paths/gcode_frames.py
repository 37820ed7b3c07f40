"""Shifts and turns of the coordinates of a G-code program."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np
from scipy.spatial.transform import RigidTransform, Rotation

from qp_twist.checks import Array
from qp_twist.errors import InvalidInput
from qp_twist.paths.program_frame import NOTHING, Frame, about_z, moved
from qp_twist.paths.program_values import numbers_of

_ORDERS = {27: "ZYX", 39: "ZXY", 57: "XYZ", 45: "XZY", 30: "YZX", 54: "YXZ"}
"""CYCLE800: the axes about which the plane is turned one after the other, each as it was turned."""


def tilted(frame: Frame, words: Mapping[str, float], scale: float) -> Frame:
    """G68.2: the origin X, Y, Z, and Euler angles I, J, K about z, x and z, as they turn."""
    if "P" in words or "Q" in words or "R" in words:
        raise InvalidInput(
            "G68.2 with P, Q or R states the plane otherwise than by Euler angles I, J, K, "
            "which is not read"
        )
    if frame.changed:
        raise InvalidInput("G68.2 in coordinates that are shifted or turned is not read")
    angles = [words.get(letter, 0.0) for letter in "IJK"]
    turn = Rotation.from_euler("ZXZ", angles, degrees=True)
    return Frame(plane=RigidTransform.from_components(_point(words, scale), turn))


def swiveled(frame: Frame, call: str, scale: float) -> tuple[Frame, str]:
    """CYCLE800: the plane of its arguments, and a note on it; nothing without any.

    ``_FR, _TC, _ST, _MODE, _X0, _Y0, _Z0, _A, _B, _C, _X1, _Y1, _Z1, …``: the plane's origin,
    angles one after the other, and its origin after the turn (SINUMERIK, *Swivel plane*).
    """
    stated = numbers_of(call, texts=(1,))  # the name of a data set
    if len(stated) < 4 or not any(value is not None for value in stated):
        return Frame(), ""
    values = [*(value or 0.0 for value in stated), *[0.0] * 13]
    order, kind = _ORDERS.get(int(values[3])), int(values[2]) % 10
    if order is None or kind > 1:
        raise InvalidInput(
            f"CYCLE800 with the mode {values[3]:g} states the plane otherwise than by angles "
            f"about one axis after the other (modes {', '.join(map(str, _ORDERS))}), which is "
            "not read"
        )
    turn = Rotation.from_euler(order, values[7:10], degrees=True)
    before, after = (scale * np.array(values[k : k + 3]) for k in (4, 10))
    plane = RigidTransform.from_components(before, turn) * moved(after)
    axes = ", ".join(f"{a} {v:g}" for a, v in zip(order, values[7:10], strict=True))
    note = f"CYCLE800 turns the plane one after the other about {axes} degrees"
    return Frame(plane=frame.whole * plane if kind == 1 else plane), note


def programmed(frame: Frame, name: str, words: Mapping[str, float], scale: float) -> Frame:
    """TRANS and ROT of a SINUMERIK, which replace all such before, and ATRANS and AROT."""
    turns = [k for k in ("X", "Y", "Z", "RPL") if words.get(k)]
    before = frame.shift if name.startswith("A") else NOTHING
    if name.endswith("TRANS"):
        return replace(frame, shift=before * moved(_point(words, scale)))
    if turns not in ([], ["Z"], ["RPL"]):
        raise InvalidInput(
            f"{name} about {' and '.join(turns)} tilts the plane without the tool, which is "
            "not read; CYCLE800 tilts both"
        )
    return replace(frame, shift=before * about_z(sum(words[k] for k in turns)))


def turned(frame: Frame, centre: Array, angle: float) -> Frame:
    """G68: coordinates turned about a point of the plane, degrees; 0 ends it."""
    return replace(frame, shift=moved(centre) * about_z(angle) * moved(-centre))


def shifted(frame: Frame, axes: Mapping[str, float], *, more: bool) -> Frame:
    """G52, and with ``more`` G92: the origin of the axes named is moved, m."""
    if frame.plane is not None or frame.turned:
        raise InvalidInput("a shift of coordinates that are turned is not read")
    origin = frame.shift.translation.copy()
    for k, letter in enumerate("XYZ"):
        if letter in axes:
            origin[k] = axes[letter] + (origin[k] if more else 0.0)
    return replace(frame, shift=moved(origin))


def ended(frame: Frame, *, shift: bool) -> Frame:
    """G69 ends turns; with ``shift``, G92.1 ends shifts."""
    kept = NOTHING if shift or frame.turned else frame.shift
    return Frame(plane=frame.plane if shift else None, shift=kept)


def _point(words: Mapping[str, float], scale: float) -> Array:
    return scale * np.array([words.get(letter, 0.0) for letter in "XYZ"])
