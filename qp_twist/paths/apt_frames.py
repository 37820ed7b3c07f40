"""Frames of an APT file: its points are moved into the first one that it states."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from scipy.spatial.transform import RigidTransform, Rotation

from qp_twist.checks import Array
from qp_twist.errors import InvalidInput
from qp_twist.paths.apt_statements import Statement, number
from qp_twist.paths.program_frame import NOTHING


class Frames(NamedTuple):
    """The frames stated so far.

    Attributes:
        first: That of the toolpath; ``None`` before one is stated.
        now: That of the points, in the first one.
        moved: Whether points were in another one.
    """

    first: RigidTransform | None = None
    now: RigidTransform = NOTHING
    moved: bool = False

    def point(self, point: Sequence[float]) -> Array:
        """A point, in the unit of the file, in the frame of the toolpath."""
        found = np.array(point)
        return found if self.now is NOTHING else self.now.apply(found)

    def vector(self, vector: Sequence[float] | Array) -> tuple[float, ...]:
        """A direction in the frame of the toolpath."""
        found = np.array(vector, dtype=np.float64)
        turned = found if self.now is NOTHING else self.now.rotation.apply(found)
        return tuple(turned.tolist())

    def then(self, of: Statement) -> Frames:
        """Those after MSYS (NX: origin, x, y) or MCS (CAMplete: x, y, z, origin)."""
        numbers = [number(of.word, argument) for argument in of.arguments]
        count = {"MSYS": 9, "MCS": 12}[of.word]
        if len(numbers) != count:
            raise InvalidInput(f"{of.word} takes {count} numbers, an origin and axes")
        axes, origin = (numbers[3:], numbers[:3]) if count == 9 else (numbers[:6], numbers[9:])
        x, y = np.reshape(axes, (2, 3))
        matrix = np.column_stack([x, y, np.cross(x, y)])
        if not np.allclose(matrix.T @ matrix, np.eye(3), atol=1e-4):
            raise InvalidInput(f"{of.word}: its axes are not perpendicular unit vectors")
        frame = RigidTransform.from_components(origin, Rotation.from_matrix(matrix))
        first = frame if self.first is None else self.first
        now = first.inv() * frame
        if np.allclose(now.as_matrix(), np.eye(4), atol=1e-9):
            return Frames(first, NOTHING, self.moved)
        return Frames(first, now, moved=True)
