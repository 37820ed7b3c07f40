"""Frames of a G-code program: shifts and turns of its coordinates."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from scipy.spatial.transform import RigidTransform, Rotation

from qp_twist.checks import Array
from qp_twist.errors import InvalidInput
from qp_twist.paths.gcode_words import NUMBER_PATTERN

_ORDERS = {27: "ZYX", 39: "ZXY", 57: "XYZ", 45: "XZY", 30: "YZX", 54: "YXZ"}
"""CYCLE800: the axes about which the plane is turned one after the other, each as it was turned."""
_NOTHING = RigidTransform.identity()


class Frames:
    """The frame of the coordinates, in that of the part.

    Attributes:
        plane: The tilted plane of G68.2 or CYCLE800; ``None`` without one.
    """

    def __init__(self) -> None:
        self.plane: RigidTransform | None = None
        self._shift = _NOTHING

    @property
    def changed(self) -> bool:
        """Whether coordinates are not those of the part."""
        return self.plane is not None or self._shift is not _NOTHING

    @property
    def whole(self) -> RigidTransform:
        """From the frame of the coordinates to that of the part."""
        return self._shift if self.plane is None else self.plane * self._shift

    @property
    def axis(self) -> tuple[float, ...] | None:
        """The tool axis in a tilted plane, which is its normal; ``None`` without one."""
        return None if self.plane is None else tuple(self.plane.as_matrix()[:3, 2].tolist())

    def tilt(self, words: Mapping[str, float], scale: float) -> None:
        """G68.2: the origin X, Y, Z, and Euler angles I, J, K about z, x and z, as they turn.

        Raises:
            InvalidInput: If it has another form (P), or a work offset was shifted before.
        """
        if "P" in words or "Q" in words or "R" in words:
            raise InvalidInput(
                "G68.2 with P, Q or R states the plane otherwise than by Euler angles I, J, K, "
                "which is not read"
            )
        if self.changed:
            raise InvalidInput("G68.2 in coordinates that are shifted or turned is not read")
        angles = [words.get(letter, 0.0) for letter in "IJK"]
        turn = Rotation.from_euler("ZXZ", angles, degrees=True)
        self.plane = RigidTransform.from_components(_point(words, scale), turn)

    def swivel(self, call: str, scale: float) -> str:
        """CYCLE800: the plane of its arguments; nothing without any.

        ``_FR, _TC, _ST, _MODE, _X0, _Y0, _Z0, _A, _B, _C, _X1, _Y1, _Z1, …``: the plane's origin,
        angles one after the other, and its origin after the turn (SINUMERIK, *Swivel plane*).

        Returns:
            A note on the plane; empty if the call cancels it.

        Raises:
            InvalidInput: If the angles are of another kind.
        """
        arguments = [part.strip() for part in call[call.index("(") + 1 : -1].split(",")]
        if not any(arguments) or len(arguments) < 4:
            self.plane, self._shift = None, _NOTHING
            return ""
        if any(not NUMBER_PATTERN.fullmatch(part or "0") for k, part in enumerate(arguments)
               if k != 1):  # fmt: skip
            raise InvalidInput(f"{call}: expected numbers")
        values = [float(part or 0.0) if k != 1 else 0.0 for k, part in enumerate(arguments)]
        values += [0.0] * (13 - len(values))
        order = _ORDERS.get(int(values[3]))
        if order is None or int(values[2]) % 10 > 1:
            raise InvalidInput(
                f"CYCLE800 with the mode {values[3]:g} states the plane otherwise than by angles "
                f"about one axis after the other (modes {', '.join(map(str, _ORDERS))}), which is "
                "not read"
            )
        turn = Rotation.from_euler(order, values[7:10], degrees=True)
        before, after = (scale * np.array(values[k : k + 3]) for k in (4, 10))
        plane = (RigidTransform.from_components(before, turn)
                 * RigidTransform.from_translation(after))  # fmt: skip
        additive = int(values[2]) % 10 == 1
        self.plane = self.whole * plane if additive else plane
        self._shift = _NOTHING
        axes = ", ".join(f"{a} {v:g}" for a, v in zip(order, values[7:10], strict=True))
        return f"CYCLE800 turns the plane one after the other about {axes} degrees"

    def program(self, name: str, words: Mapping[str, float], scale: float) -> None:
        """TRANS and ROT of a SINUMERIK, which replace all such before, and ATRANS and AROT.

        Raises:
            InvalidInput: If ROT has several angles.
        """
        turns = [k for k in ("X", "Y", "Z", "RPL") if words.get(k)]
        if not name.startswith("A"):
            self._shift = _NOTHING
        if name.endswith("TRANS"):
            self._shift *= RigidTransform.from_translation(_point(words, scale))
        elif turns in ([], ["Z"], ["RPL"]):
            angle = sum(words[k] for k in turns)
            self._shift *= RigidTransform.from_rotation(
                Rotation.from_euler("Z", angle, degrees=True)
            )
        else:
            raise InvalidInput(
                f"{name} about {' and '.join(turns)} tilts the plane without the tool, which is "
                "not read; CYCLE800 tilts both"
            )

    def turn(self, centre: Array, angle: float) -> None:
        """G68: coordinates turned about a point of the plane, degrees; 0 ends it."""
        turn = Rotation.from_euler("Z", angle, degrees=True)
        moved = RigidTransform.from_translation
        self._shift = moved(centre) * RigidTransform.from_rotation(turn) * moved(-centre)

    def shift(self, axes: Mapping[str, float], *, more: bool) -> None:
        """G52, and with ``more`` G92: the origin of the axes named is moved, m.

        Raises:
            InvalidInput: If the coordinates are turned.
        """
        if self.plane is not None or self._shift.rotation.magnitude() > 0.0:
            raise InvalidInput("a shift of coordinates that are turned is not read")
        origin = self._shift.translation.copy()
        for k, letter in enumerate("XYZ"):
            if letter in axes:
                origin[k] = axes[letter] + (origin[k] if more else 0.0)
        self._shift = RigidTransform.from_translation(origin)

    def end(self, *, shift: bool) -> None:
        """G69 ends turns; with ``shift``, G92.1 ends shifts."""
        if shift or self._shift.rotation.magnitude() > 0.0:
            self._shift = _NOTHING
        if not shift:
            self.plane = None


def _point(words: Mapping[str, float], scale: float) -> Array:
    return scale * np.array([words.get(letter, 0.0) for letter in "XYZ"])
