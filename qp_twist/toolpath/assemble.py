"""Curves from the rows of a file: checks that every format needs."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

from qp_twist.errors import InvalidInput
from qp_twist.toolpath.columns import Orientation
from qp_twist.toolpath.toolpath import Curve, Meaning, Toolpath
from qp_twist.toolpath.turning import angles_between, turns_between

LARGEST = 100.0
"""Coordinates beyond it, m, are taken for a wrong unit."""
SAME_POINT = 1e-9
"""Points nearer to each other, m, are the same."""
SAME_DIRECTION = 1e-9
"""And directions, rad."""


@dataclass
class Rows:
    """The rows of one curve, as they are read.

    Attributes:
        name: Of the curve; empty if the file has none.
        positions: m.
        directions: Three or four numbers for each row, or none.
        lines: Of the file, from 1.
    """

    name: str = ""
    positions: list[Sequence[float]] = field(default_factory=list)
    directions: list[Sequence[float]] = field(default_factory=list)
    lines: list[int] = field(default_factory=list)


def assembled(
    path: Path,
    orientation: Orientation,
    curves: Sequence[Rows],
    call: str,
    notes: Sequence[str],
) -> Toolpath:
    """The toolpath of some curves.

    Args:
        path: The file.
        orientation: What the directions state; angles in radians, a quaternion's w first.
        curves: Rows of at least one curve; curves without rows are left out.
        call: What messages call the columns of the direction.
        notes: Of the reader.

    Raises:
        InvalidInput: If there is no row, a coordinate is too large, or a direction states nothing.
    """
    curves = [rows for rows in curves if rows.positions]
    if not curves:
        raise InvalidInput(f"{path.name}: there is no point in it.")
    found, dropped = [], []
    for number, rows in enumerate(curves, start=1):
        curve = _curve(path, orientation, rows, rows.name or str(number), call)
        curve, again = _without_repetitions(curve)
        found.append(curve)
        dropped += again
    meaning: Meaning = "rotation" if orientation in ("quaternion", "rpy") else orientation  # type: ignore[assignment]
    notes = list(notes)
    if dropped:
        first = f"line {dropped[0]}" if len(dropped) == 1 else f"the first in line {dropped[0]}"
        notes.append(
            f"{len(dropped)} points that repeat the one before were dropped ({first})."
            if len(dropped) > 1
            else f"a point that repeats the one before was dropped ({first})."
        )
    return Toolpath(path, meaning, tuple(found), tuple(notes))


def _curve(path: Path, orientation: Orientation, rows: Rows, name: str, call: str) -> Curve:
    positions = np.array(rows.positions, dtype=np.float64)
    lines = np.array(rows.lines, dtype=np.int64)
    far = np.abs(positions).max(axis=1) > LARGEST
    if far.any():
        first = int(np.argmax(far))
        raise InvalidInput(
            f"{path.name}, line {lines[first]}: the point is {np.abs(positions[first]).max():.4g} "
            f"m from the origin of its file, more than {LARGEST:g} m; if the numbers are "
            'millimetres, say length_unit = "mm".'
        )
    if orientation == "none":
        return Curve(name, positions, None, None, lines)
    values = np.array(rows.directions, dtype=np.float64)
    if orientation == "rpy":
        rotations = Rotation.from_euler("xyz", values).as_matrix()
        return Curve(name, positions, None, rotations, lines)
    largest = np.abs(values).max(axis=1, keepdims=True)
    nothing = largest[:, 0] < 1e-12
    if nothing.any():
        line = lines[int(np.argmax(nothing))]
        raise InvalidInput(
            f"{path.name}, line {line}, {call}: the {orientation} is zero and has no direction."
        )
    lengths = largest[:, 0] * np.linalg.norm(values / largest, axis=1)
    units = values / largest
    units /= np.linalg.norm(units, axis=1, keepdims=True)
    if orientation != "quaternion":
        return Curve(name, positions, units, None, lines)
    off = np.abs(lengths - 1.0) > 0.01
    if off.any():
        first = int(np.argmax(off))
        raise InvalidInput(
            f"{path.name}, line {lines[first]}, {call}: the quaternion has the length "
            f"{lengths[first]:.4g} instead of 1; check which columns it is in."
        )
    rotations = Rotation.from_quat(units[:, [1, 2, 3, 0]]).as_matrix()
    return Curve(name, positions, None, rotations, lines)


def _without_repetitions(curve: Curve) -> tuple[Curve, list[int]]:
    """The curve without points equal to the one before, and the lines of those."""
    same = np.linalg.norm(np.diff(curve.positions, axis=0), axis=1) < SAME_POINT
    if curve.vectors is not None:
        same &= angles_between(curve.vectors[:-1], curve.vectors[1:]) < SAME_DIRECTION
    if curve.rotations is not None:
        same &= turns_between(curve.rotations[:-1], curve.rotations[1:]) < SAME_DIRECTION
    keep = np.concatenate([[True], ~same])
    return curve.part(keep), [int(line) for line in curve.lines[~keep]]
