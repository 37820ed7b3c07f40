"""Where the coordinates of a program are: datum, tilted plane, and shift or turn in it."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy.spatial.transform import RigidTransform, Rotation

from qp_twist.checks import Array

NOTHING = RigidTransform.identity()


@dataclass(frozen=True)
class Frame:
    """The frame of a program's coordinates in that of the part: one transform after the other.

    Attributes:
        datum: A shift of the datum, m.
        plane: A tilted plane, whose normal is the tool axis; ``None`` without one.
        shift: A shift or turn of the coordinates, in that plane.
    """

    datum: RigidTransform = NOTHING
    plane: RigidTransform | None = None
    shift: RigidTransform = NOTHING

    @cached_property
    def whole(self) -> RigidTransform:
        """From the frame of the coordinates to that of the part."""
        plane = NOTHING if self.plane is None else self.plane
        return self.datum * plane * self.shift

    @cached_property
    def changed(self) -> bool:
        """Whether coordinates are not those of the part."""
        return self.plane is not None or bool(np.any(self.whole.as_matrix() != np.eye(4)))

    @cached_property
    def axis(self) -> tuple[float, ...] | None:
        """The tool axis in a tilted plane; ``None`` without one."""
        return None if self.plane is None else tuple(self.plane.as_matrix()[:3, 2].tolist())

    @cached_property
    def turned(self) -> bool:
        """Whether coordinates are turned in their plane."""
        return float(self.shift.rotation.magnitude()) > 0.0


def moved(by: Array) -> RigidTransform:
    """A shift, m, (3,)."""
    return RigidTransform.from_translation(by)


def about_z(angle: float) -> RigidTransform:
    """A turn about z, degrees."""
    return RigidTransform.from_rotation(Rotation.from_euler("z", angle, degrees=True))
