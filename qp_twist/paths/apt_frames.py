"""Frames of the points of an APT-CL file."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from mink import SE3, SO3

from qp_twist.checks import Array
from qp_twist.errors import InvalidInput
from qp_twist.paths.apt_statements import Statement, not_read, number


class Frames:
    """The frame of the points that are read, and those of the others.

    The first frame that a file states is that of the toolpath; points in another one are moved into
    it. CAMWorks' CSYS is a frame of the machine's set-up, and none of the points.

    Attributes:
        moved: Whether points were in another one.
    """

    def __init__(self) -> None:
        self._first: SE3 | None = None
        self._now: SE3 | None = None
        self._in_world = self.moved = False

    def point(self, point: Array) -> Array:
        """A point, (3,), in the unit of the file, in the frame of the toolpath."""
        return point if self._now is None else np.asarray(self._now.apply(point))

    def vector(self, vector: Sequence[float] | Array) -> tuple[float, ...]:
        """A direction, (3,), in the frame of the toolpath."""
        turned = np.array(vector, dtype=np.float64)
        if self._now is not None:
            turned = self._now.rotation().apply(turned)
        return tuple(turned.tolist())

    def msys(self, of: Statement) -> bool:
        """MSYS of NX, and MCS of CAMplete: the points that follow are in a frame of the part.

        MSYS has the origin, then its x and y axes; MCS its x, y and z axes, then the origin.

        Returns:
            Whether they are moved out of it.

        Raises:
            InvalidInput: If it has other numbers, or the axes are not perpendicular.
        """
        numbers = [number(of.word, argument) for argument in of.arguments]
        if len(numbers) != (9 if of.word == "MSYS" else 12):
            raise InvalidInput(f"{of.word} takes an origin and axes; got {len(numbers)} numbers")
        origin = numbers[:3] if of.word == "MSYS" else numbers[9:]
        x, y = np.reshape(numbers[3:9] if of.word == "MSYS" else numbers[:6], (2, 3))
        axes = np.column_stack([x, y, np.cross(x, y)])
        if not np.allclose(axes.T @ axes, np.eye(3), atol=1e-4):
            raise InvalidInput(f"{of.word}: its axes are not perpendicular unit vectors")
        frame = SE3.from_rotation_and_translation(
            SO3.from_matrix(np.linalg.qr(axes)[0] * np.sign(np.diag(np.linalg.qr(axes)[1]))),
            np.array(origin),
        )
        if self._first is None:
            self._first = frame
            return False
        way = self._first.inverse() @ frame
        same = np.allclose(way.as_matrix(), np.eye(4), atol=1e-9)
        self._now = None if same else way
        self.moved |= not same
        return not same

    def trntyp(self, of: Statement) -> None:
        """TRNTYP of CAMWorks: the points that follow are the part's.

        Raises:
            InvalidInput: If they are in another frame.
        """
        if of.arguments[:1] != ["WORLD"]:
            raise not_read(f"TRNTYP/{','.join(of.arguments[:1])}", "a change of coordinates")
        self._in_world = True

    def csys(self, of: Statement) -> bool:
        """CSYS: rows of a rotation, each with a part of an origin, of the machine's set-up.

        Returns:
            Whether it states one.

        Raises:
            InvalidInput: If the points are in it.
        """
        numbers = [number(of.word, argument) for argument in of.arguments]
        if numbers == np.eye(3, 4).ravel().tolist():
            return False
        if not self._in_world:
            raise not_read("CSYS", "a change of coordinates")
        return True
