"""Where the coordinates of a Klartext program are: datum shifts, rotations, tilted planes."""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import replace

import numpy as np
from scipy.spatial.transform import RigidTransform, Rotation

from qp_twist.errors import InvalidInput
from qp_twist.paths.heidenhain_blocks import number, words
from qp_twist.paths.program_frame import Frame

_NOTHING = {9: "dwell", 13: "orientation of the spindle", 32: "tolerance", 392: "load"}
"""Cycles that act at once and move nothing."""
_CHANGES = {
    8: "a mirrored path", 11: "a scaled path", 12: "a call of another program",
    19: "a tilted plane by angles whose meaning the machine's parameters decide",
    26: "a scaled path",
}  # fmt: skip
"""Cycles that act at once and are not read, unless all their values are those of their reset."""
IMMEDIATE = {7, 10, *_NOTHING, *_CHANGES}
"""Cycles that act at once, and not when they are called."""


def by_cycle(
    frame: Frame, kind: int, text: str, parameters: Mapping[str, float], scale: float
) -> Frame:
    """The frame after a line of a cycle that acts at once.

    Raises:
        InvalidInput: If it changes the frame in a way that is not read.
    """
    values = words(text, parameters).values if re.match(r"I?[XYZABC]\s*[-+0-9Q]", text) else {}
    if kind == 7 and values:
        if frame.plane is not None and any(values.values()):
            raise InvalidInput(
                "a shift of the datum in a tilted plane is not read; have the CAM system write "
                "it before PLANE"
            )
        origin = frame.datum.translation.copy()
        for name, value in values.items():
            if name[-1] in "XYZ":
                k = "XYZ".index(name[-1])
                origin[k] = scale * value + (origin[k] if name[0] == "I" else 0.0)
            elif value:
                raise InvalidInput(f"a shift of the datum in {name[-1]} is not read")
        return replace(frame, datum=RigidTransform.from_translation(origin))
    if kind == 7 and re.match(r"[#N]", text):
        raise InvalidInput("a datum of a table is not known; write the shift as X, Y, Z")
    if kind == 10 and (match := re.match(r"(I?)ROT ?([-+Q0-9].*)", text)):
        if match[1] or frame.plane is not None:
            raise InvalidInput("IROT, and ROT in a tilted plane, are not read")
        turn = Rotation.from_euler("z", number(match[2], parameters), degrees=True)
        return replace(frame, shift=RigidTransform.from_rotation(turn))
    if kind in _CHANGES and text:
        match = re.fullmatch(r"SCL ?([-+0-9.,]+)", text)
        same = match is not None and number(match[1], parameters) == 1.0
        if not same and not (kind == 19 and values and not any(values.values())):
            raise InvalidInput(f"cycle {kind} is {_CHANGES[kind]}, which is not read")
    return frame


def by_plane(frame: Frame, text: str, parameters: Mapping[str, float]) -> Frame:
    r"""The frame after PLANE: SPATIAL or RESET.

    The spatial angles turn about the machine's X, then Y, then Z, all of them fixed:
    :math:`\mathbf R = \mathbf R_z(\mathrm{SPC})\,\mathbf R_y(\mathrm{SPB})\,
    \mathbf R_x(\mathrm{SPA})` (iTNC 530, User's Manual, *PLANE SPATIAL*).

    Raises:
        InvalidInput: If it is another one, or in a rotated plane.
    """
    kind, _, rest = text.partition(" ")
    if kind == "RESET":
        return replace(frame, plane=None)
    angles = re.match(r"((?:\s*SP[ABC]\s*[-+]?\s*[Q0-9.,]+)+)", rest)
    if kind != "SPATIAL" or angles is None or frame.turned:
        raise InvalidInput(
            f"PLANE {kind} is a tilted plane that is not read here; have the CAM system write "
            "PLANE SPATIAL SPA… SPB… SPC…, and no rotation before it"
        )
    values = words(angles[1], parameters).values
    if set(values) != {"SPA", "SPB", "SPC"}:
        raise InvalidInput("PLANE SPATIAL takes SPA, SPB and SPC")
    turn = Rotation.from_euler("xyz", [values[k] for k in sorted(values)], degrees=True)
    plane = RigidTransform.from_rotation(turn)
    return replace(frame, plane=plane if np.any(plane.as_matrix() != np.eye(4)) else None)
