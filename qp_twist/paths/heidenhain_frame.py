"""Where the coordinates of a Klartext program are: datum shifts, rotations, tilted planes."""

from __future__ import annotations

import re
from collections.abc import Mapping

import numpy as np
from scipy.spatial.transform import Rotation

from qp_twist.checks import Array
from qp_twist.errors import InvalidInput
from qp_twist.paths.heidenhain_blocks import number, words

_NOTHING = {9: "dwell", 13: "orientation of the spindle", 32: "tolerance", 392: "load"}
"""Cycles that act at once and move nothing."""
_CHANGES = {
    8: "a mirrored path", 11: "a scaled path", 12: "a call of another program",
    19: "a tilted plane by angles whose meaning the machine's parameters decide",
    26: "a scaled path",
}  # fmt: skip
"""Cycles that act at once and are not read, unless all their values are those of their reset."""


class Frame:
    r"""The frame of a program's coordinates, :math:`\mathbf p' = \mathbf t + \mathbf R\,\mathbf p`.

    Attributes:
        origin: t, in the unit of the program, by axis.
        tilt: Rotation of PLANE, (3, 3).
        turn: Rotation of cycle 10, (3, 3).
        rotation: R, the product of both.
        tilted: Whether a plane is tilted.
        moved: Whether it is another frame than the part's.
    """

    def __init__(self) -> None:
        self.origin = {"X": 0.0, "Y": 0.0, "Z": 0.0}
        self.tilt, self.turn = np.eye(3), np.eye(3)
        self.rotation, self.tilted, self.moved = np.eye(3), False, False

    def _set(self) -> None:
        self.rotation = self.tilt @ self.turn
        self.tilted = not np.array_equal(self.tilt, np.eye(3))
        self.moved = any(self.origin.values()) or not np.array_equal(self.rotation, np.eye(3))

    def placed(self, points: Array, scale: float) -> Array:
        """Points, m, (N, 3), in the frame of the part; ``scale`` is that of the origin."""
        shift = scale * np.array([*self.origin.values()])
        return np.asarray(shift + points @ self.rotation.T)

    def unplaced(self, point: Array, scale: float) -> Array:
        """A point of the part's frame, m, (3,), in this one."""
        shift = scale * np.array([*self.origin.values()])
        return np.asarray(self.rotation.T @ (point - shift))

    def cycle(self, number_: int, text: str, parameters: Mapping[str, float]) -> bool:
        """Read a line of a cycle that acts at once; whether the frame changes.

        Raises:
            InvalidInput: If it changes the frame in a way that is not read.
        """
        values = words(text, parameters).values if re.match(r"I?[XYZABC]\s*[-+0-9Q]", text) else {}
        if number_ == 7 and values:
            if self.tilted and any(values.values()):
                raise InvalidInput(
                    "a shift of the datum in a tilted plane is not read; have the CAM system write "
                    "it before PLANE"
                )
            for name, value in values.items():
                axis = name[-1]
                if axis not in self.origin:
                    if value:
                        raise InvalidInput(f"a shift of the datum in {axis} is not read")
                    continue
                self.origin[axis] = value + (self.origin[axis] if name[0] == "I" else 0.0)
            self._set()
            return True
        if number_ == 7 and re.match(r"[#N]", text):
            raise InvalidInput("a datum of a table is not known; write the shift as X, Y, Z")
        if number_ == 10 and (match := re.match(r"(I?)ROT ?([-+Q0-9].*)", text)):
            if match[1] or self.tilted:
                raise InvalidInput("IROT, and ROT in a tilted plane, are not read")
            self.turn = Rotation.from_euler("z", number(match[2], parameters), degrees=True)\
                .as_matrix()  # fmt: skip
            self._set()
            return True
        if number_ in _CHANGES and text:
            scale = re.fullmatch(r"SCL ?([-+0-9.,]+)", text)
            same = scale is not None and number(scale[1], parameters) == 1.0
            if not same and not (number_ == 19 and values and not any(values.values())):
                raise InvalidInput(f"cycle {number_} is {_CHANGES[number_]}, which is not read")
        return False

    def plane(self, text: str, parameters: Mapping[str, float]) -> None:
        r"""PLANE: SPATIAL or RESET.

        The spatial angles turn about the machine's X, then Y, then Z, all of them fixed:
        :math:`\mathbf R = \mathbf R_z(\mathrm{SPC})\,\mathbf R_y(\mathrm{SPB})\,
        \mathbf R_x(\mathrm{SPA})` (iTNC 530, User's Manual, *PLANE SPATIAL*).

        Raises:
            InvalidInput: If it is another one, or in a rotated plane.
        """
        kind, _, rest = text.partition(" ")
        if kind == "RESET":
            self.tilt = np.eye(3)
            self._set()
            return
        angles = re.match(r"((?:\s*SP[ABC]\s*[-+]?\s*[Q0-9.,]+)+)", rest)
        if kind != "SPATIAL" or angles is None or not np.array_equal(self.turn, np.eye(3)):
            raise InvalidInput(
                f"PLANE {kind} is a tilted plane that is not read here; have the CAM system write "
                "PLANE SPATIAL SPA… SPB… SPC…, and no rotation before it"
            )
        values = words(angles[1], parameters).values
        if set(values) != {"SPA", "SPB", "SPC"}:
            raise InvalidInput("PLANE SPATIAL takes SPA, SPB and SPC")
        turned = Rotation.from_euler("xyz", [values[k] for k in sorted(values)], degrees=True)
        self.tilt = turned.as_matrix()
        self._set()


def is_immediate(number_: int) -> bool:
    """Whether a cycle acts at once, and not when it is called."""
    return number_ in (7, 10) or number_ in _NOTHING or number_ in _CHANGES
