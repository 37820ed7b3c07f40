"""A toolpath as arrays: the curves of a file."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Literal, NamedTuple

import numpy as np
import numpy.typing as npt

from qp_twist.checks import Array
from qp_twist.errors import InvalidInput
from qp_twist.files import LengthUnit

Lines = npt.NDArray[np.int64]
Meaning = Literal["axis", "normal", "rotation", "none"]
Part = Literal["approach", "contact", "retreat", "transfer"]
SAME_POINT = 1e-9
"""Points closer together, m, count as one."""
SAME_DIRECTION = 1e-9
"""The same for directions, rad."""
LARGEST_NUMBER = 1e12
"""Beyond it, a number of a program is a mistake: in inches its last digit is above a micrometre."""


class ProcessWord(NamedTuple):
    """A word of a toolpath that moves nothing and is about the process.

    Attributes:
        line: Its line of the file.
        text: The statement.
        after: Line of the motion before it; 0 without one.
        position: Where that ends, in the frame of the toolpath, m; empty without one.
    """

    line: int
    text: str
    after: int = 0
    position: tuple[float, ...] = ()


_IN_PLACE = 1000.0
"""A tool that turns faster along its path, rad/m, turns in place."""


@dataclass(frozen=True, eq=False)
class Curve:
    """Points that a tool passes without lifting.

    Attributes:
        name: Its name in the file; ``"3"`` for the third curve of a file without names.
        positions: Of the points, in the frame of the file, m, (N, 3).
        vectors: Tool axes or surface normals, unit vectors, (N, 3); ``None`` if the file has none.
        rotations: Of the tool to the frame of the file, (N, 3, 3); ``None`` likewise.
        lines: Line of the file of each point, from 1, (N,).
        feeds: Feed of the motion to each point, m/s, (N,), NaN without one; ``None`` if the file
            has none.
        before: Points of the file that lead to its first point in rapid motion; ``None`` without
            any.
        after: Points that lead away from the last point of the file's last curve likewise.
        role: Part of the path that it is.
        by_joint_move: Whether a joint move leads to its first point.
    """

    name: str
    positions: Array
    vectors: Array | None
    rotations: Array | None
    lines: Lines
    feeds: Array | None = None
    before: Curve | None = None
    after: Curve | None = None
    role: Part = "contact"
    by_joint_move: bool = False

    def __len__(self) -> int:
        return len(self.positions)

    @property
    def axes(self) -> Array:
        """Tool axes or surface normals, or z of the rotations, (N, 3); NaN without any."""
        if self.vectors is not None:
            return self.vectors
        if self.rotations is not None:
            return np.asarray(self.rotations[:, :, 2])
        return np.full((len(self), 3), np.nan)

    def __repr__(self) -> str:
        return f"Curve({self.name!r}, {len(self)} points)"

    def facing(self, sign: float) -> Curve:
        """The curve with z along the axes of the file, or against them (-1); x stays."""
        return replace(
            self,
            vectors=None if self.vectors is None else sign * self.vectors,
            rotations=None
            if self.rotations is None
            else self.rotations * np.array([1.0, sign, sign]),
            before=self.before and self.before.facing(sign),
            after=self.after and self.after.facing(sign),
        )

    def part(self, index: npt.ArrayLike) -> Curve:
        """The points of some indices, or of a mask."""
        index = np.asarray(index)
        return replace(
            self,
            positions=self.positions[index],
            vectors=None if self.vectors is None else self.vectors[index],
            rotations=None if self.rotations is None else self.rotations[index],
            lines=self.lines[index],
            feeds=None if self.feeds is None else self.feeds[index],
        )


@dataclass(frozen=True, eq=False)
class Toolpath:
    """Contents of a toolpath file.

    Attributes:
        source: The file.
        meaning: Meaning of the curves' directions: the tool axis, from the tip to the holder; the
            surface normal, away from the part; the whole rotation of the tool; or none.
        curves: The curves, in the order of the file.
        assumptions: A sentence for each thing that was assumed.
        passed_over: A sentence for what is in the file and not in the path.
        unit: Unit of the positions in the file.
        unit_in_file: Whether the file specifies it.
        words: What switches the process on and off, in the order of the file.
    """

    source: Path
    meaning: Meaning
    curves: tuple[Curve, ...]
    assumptions: tuple[str, ...] = ()
    passed_over: tuple[str, ...] = ()
    unit: LengthUnit = "m"
    unit_in_file: bool = True
    words: tuple[ProcessWord, ...] = ()

    @property
    def notes(self) -> tuple[str, ...]:
        """What was assumed, and what was passed over."""
        return (*self.assumptions, *self.passed_over)

    @property
    def has_roll(self) -> bool:
        """Whether it states the roll about the tool's axis, too."""
        return self.curves[0].rotations is not None

    @property
    def feeds(self) -> tuple[float, float] | None:
        """Lowest and highest feed of the file, m/s; ``None`` if it has none."""
        feeds_of_curves = [curve.feeds for curve in self.curves if curve.feeds is not None]
        if not feeds_of_curves:
            return None
        feeds = np.concatenate(feeds_of_curves)
        feeds = feeds[np.isfinite(feeds)]  # a curve may be one point, to which none leads
        return (float(feeds.min()), float(feeds.max())) if len(feeds) else None

    def turns_in_place(self, *, rapids: bool) -> int:
        """How often the tool turns while it stands, or nearly so: above 1 rad per mm of path.

        Args:
            rapids: Whether the points in rapid motion, and the ways from curve to curve, belong to
                the path.
        """
        if not rapids:
            return sum(_turns_in_place([curve]) for curve in self.curves)
        parts = [part for curve in self.curves for part in (curve.before, curve, curve.after)]
        return _turns_in_place([part for part in parts if part is not None])

    @property
    def has_ways(self) -> bool:
        """Whether the file itself leads the tool away from each curve and to the next one.

        It does by points in rapid motion between them; or if the first one ends with a motion along
        its tool axis, away from the part, and the next one begins with a motion against it, both at
        less than 60° from the axis.
        """
        pairs = zip(self.curves[:-1], self.curves[1:], strict=True)
        gaps = [b.before is not None or (lifts(a, -1) and lifts(b, 0)) for a, b in pairs]
        ends = (self.curves[0].before, self.curves[-1].after)
        return all(gaps) and (bool(gaps) or any(way is not None for way in ends))

    @property
    def extent(self) -> float:
        """A lower bound on the largest distance between two of its points, m.

        The largest of the distances from the first point and the sides of the bounding box.
        """
        positions = np.concatenate([curve.positions for curve in self.curves])
        from_first = np.linalg.norm(positions - positions[0], axis=1).max()
        return float(max(from_first, np.ptp(positions, axis=0).max()))

    def chosen(self, curves: Sequence[str | int]) -> Toolpath:
        """The toolpath with some of its curves, in the order of ``curves``.

        Args:
            curves: Names, or numbers counted from 1. A name stands for all curves that have it.

        Raises:
            InvalidInput: If there is no such curve.
        """
        found: list[Curve] = []
        for which in curves:
            if isinstance(which, int):
                matching = list(self.curves[which - 1 : which]) if which > 0 else []
            else:
                matching = [curve for curve in self.curves if curve.name == which]
            if not matching:
                names = ", ".join(dict.fromkeys(repr(curve.name) for curve in self.curves[:20]))
                raise InvalidInput(
                    f"{self.source.name}: there is no curve {which!r}; it has "
                    f"{len(self.curves)}: {names}{', …' if len(self.curves) > 20 else ''}."
                )
            found += matching
        return replace(self, curves=tuple(found))

    def __repr__(self) -> str:
        points = sum(map(len, self.curves))
        return (
            f"Toolpath({self.source.name!r}, {len(self.curves)} curves, {points} points, "
            f"{self.meaning})"
        )


def _turns_in_place(parts: Sequence[Curve]) -> int:
    """The same of some points in the order of the path."""
    directions = list[Array]()
    for part in parts:
        if part.vectors is not None:
            directions.append(part.vectors)
        elif part.rotations is not None:
            # The columns x and y determine a rotation.
            directions.append(part.rotations[:, :, :2].reshape(-1, 6))
    if len(directions) < len(parts) or not parts:
        return 0
    moved, turned = (
        np.linalg.norm(np.diff(np.concatenate(values), axis=0), axis=1)
        for values in ([part.positions for part in parts], directions)
    )
    standing = turned > SAME_DIRECTION + _IN_PLACE * moved
    return int(standing[:1].sum() + (standing[1:] & ~standing[:-1]).sum())


def lifts(curve: Curve, end: Literal[0, -1]) -> bool:
    """Whether a curve begins towards the part (0), or ends away from it (-1)."""
    if curve.vectors is None or len(curve) < 2:
        return False
    inner = 1 if end == 0 else -2
    motion = curve.positions[end] - curve.positions[inner]
    return bool(motion @ curve.vectors[end] > 0.5 * np.linalg.norm(motion))
