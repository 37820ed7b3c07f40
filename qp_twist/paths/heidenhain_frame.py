"""Where the coordinates of a Klartext program are: datum shifts, rotations, tilted planes."""

from __future__ import annotations

import re
from dataclasses import replace

import numpy as np
from scipy.spatial.transform import RigidTransform, Rotation

from qp_twist.errors import InvalidInput
from qp_twist.paths.heidenhain_blocks import number, words
from qp_twist.paths.program_frame import Frame, about_z, moved
from qp_twist.paths.program_values import Variables

_NOTHING = (9, 13, 32, 392)
"""Cycles that act at once and move nothing: dwell, orientation of the spindle, tolerance, load."""
_CHANGES = {
    8: "a mirrored path", 11: "a scaled path", 12: "a call of another program",
    19: "a tilted plane by angles whose meaning the machine's parameters decide",
    26: "a scaled path",
}  # fmt: skip
"""Cycles that act at once and are not read, unless all their values are those of their reset."""
IMMEDIATE = {7, 10, *_NOTHING, *_CHANGES}
"""Cycles that act at once, and not when they are called."""


def by_cycle(frame: Frame, kind: int, text: str, values: Variables, scale: float) -> Frame:
    """The frame after a line of a cycle that acts at once."""
    block = words(text if re.match(r"I?[XYZABC]\s*[-+0-9Q]", text) else "", values)
    if kind == 7 and block.words:
        if frame.plane is not None and any(block.words.values()):
            raise InvalidInput(
                "a shift of the datum in a tilted plane is not read; have the CAM system write "
                "it before PLANE"
            )
        origin = frame.datum.translation.copy()
        for name, value in block.words.items():
            if name in ("X", "Y", "Z"):
                k = "XYZ".index(name)
                origin[k] = scale * value + (origin[k] if name in block.kinds else 0.0)
            elif value:
                raise InvalidInput(f"a shift of the datum in {name} is not read")
        return replace(frame, datum=moved(origin))
    if kind == 7 and re.match(r"[#N]", text):
        raise InvalidInput("a datum of a table is not known; write the shift as X, Y, Z")
    if kind == 10 and (match := re.match(r"(I?)ROT ?([-+Q0-9].*)", text)):
        if match[1] or frame.plane is not None:
            raise InvalidInput("IROT, and ROT in a tilted plane, are not read")
        return replace(frame, shift=about_z(number(match[2], values)))
    if kind in _CHANGES and text:
        match = re.fullmatch(r"SCL ?([-+0-9.,]+)", text)
        same = match is not None and number(match[1], values) == 1.0
        if not same and not (kind == 19 and block.words and not any(block.words.values())):
            raise InvalidInput(f"cycle {kind} is {_CHANGES[kind]}, which is not read")
    return frame


def by_plane(frame: Frame, text: str, values: Variables) -> Frame:
    r"""The frame after PLANE: SPATIAL or RESET.

    The spatial angles turn about the machine's X, then Y, then Z, all of them fixed:
    :math:`\mathbf R = \mathbf R_z(\mathrm{SPC})\,\mathbf R_y(\mathrm{SPB})\,
    \mathbf R_x(\mathrm{SPA})` (iTNC 530, User's Manual, *PLANE SPATIAL*).
    """
    kind, _, rest = text.partition(" ")
    if kind == "RESET":
        return replace(frame, plane=None)
    stated = re.match(r"((?:\s*SP[ABC]\s*[-+]?\s*[Q0-9.,]+)+)", rest)
    if kind != "SPATIAL" or stated is None or frame.turned:
        raise InvalidInput(
            f"PLANE {kind} is a tilted plane that is not read here; have the CAM system write "
            "PLANE SPATIAL SPA… SPB… SPC…, and no rotation before it"
        )
    angles = words(stated[1], values).words
    if set(angles) != {"SPA", "SPB", "SPC"}:
        raise InvalidInput("PLANE SPATIAL takes SPA, SPB and SPC")
    turn = Rotation.from_euler("xyz", [angles[k] for k in sorted(angles)], degrees=True)
    plane = RigidTransform.from_rotation(turn)
    return replace(frame, plane=plane if np.any(plane.as_matrix() != np.eye(4)) else None)
