"""Points as a reader finds them become the curves of a toolpath, with the checks of all formats."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import replace
from itertools import pairwise
from pathlib import Path
from typing import NamedTuple

import numpy as np

from qp_twist.checks import Array, Mask
from qp_twist.errors import InvalidInput
from qp_twist.files import LENGTHS, LengthUnit, Problems
from qp_twist.geometry import perpendicular
from qp_twist.paths.column_names import Orientation
from qp_twist.paths.toolpath import SAME_DIRECTION, SAME_POINT, Curve, Lines, Meaning, Toolpath
from qp_twist.paths.turning import angles_between, turns_between

LARGEST_COORDINATE = 100.0
"""Coordinates beyond it, m, indicate a wrong unit."""
LONGEST_REACH = 4.7
"""Of the arms on the market, m: FANUC's M-2000iA/1700L reaches 4.68 m."""
LARGEST_FEED = 100.0
"""Feeds above it, m/s, indicate a wrong unit."""


class Points(NamedTuple):
    """Points of a file, and the motions that lead to them.

    Attributes:
        positions: m, (N, 3).
        directions: (N, 3), (N, 4), (N, 9) or (N, 0); angles in rad, a quaternion's w first; of an
            axis and x of the tool beside it (N, 6).
        lines: Lines of the file, from 1, (N,).
        feeds: m/s, (N,), NaN without one.
        name: Of the part of the file.
    """

    positions: Array
    directions: Array
    lines: Lines
    feeds: Array
    name: str = ""

    def part(self, at: slice | list[int], name: str = "") -> Points:
        """Some of the points."""
        arrays = (self.positions[at], self.directions[at], self.lines[at], self.feeds[at])
        return Points(*arrays, name)


class PointsOfCurve(NamedTuple):
    """The points of a curve, and those that lead to it, or away from it, in rapid motion."""

    points: Points
    before: Points | None = None
    after: Points | None = None


def curves_between_rapids(
    points: Points, names: Sequence[str], rapid: Mask, begins: Mask
) -> list[PointsOfCurve]:
    """The curves: points with no rapid motion between them.

    A point to which only rapid motion leads, and which only rapid motion leaves, belongs to no
    curve: it is in ``before`` of the next one, or in ``after`` of the last.

    Args:
        points: In the order of the file.
        names: Of the part of the file that each is in; the first that is not empty counts.
        rapid: Whether the tool gets to each in rapid motion, (N,).
        begins: Whether it is unknown where the tool comes from, (N,).
    """
    moved = np.linalg.norm(np.diff(points.positions, axis=0), axis=1) >= SAME_POINT
    moved |= (np.diff(points.directions, axis=0) != 0.0).any(axis=1)
    starts = rapid | begins
    starts[:1] = True
    found: list[PointsOfCurve] = []
    waiting: list[int] = []

    def way() -> Points | None:
        return points.part(waiting) if waiting else None

    for begin, end in pairwise([*np.flatnonzero(starts).tolist(), len(starts)]):
        if moved[begin : end - 1].any():
            name = next(filter(None, names[begin:end]), "")
            found.append(PointsOfCurve(points.part(slice(begin, end), name), way()))
            waiting = []
        elif not waiting or moved[waiting[-1] : begin].any():
            waiting.append(begin)
    if found and waiting:
        found[-1] = found[-1]._replace(after=way())
    return found


def toolpath_of(
    path: Path,
    orientation: Orientation,
    curves: Sequence[PointsOfCurve],
    call: str,
    problems: Problems,
    *,
    assumptions: Iterable[str],
    passed_over: Iterable[str],
    unit: LengthUnit,
    unit_in_file: bool,
) -> Toolpath:
    """The toolpath of some curves.

    Args:
        path: The file.
        orientation: Meaning of the directions, whose columns messages name ``call``.
        curves: Their points.
        call: See ``orientation``.
        problems: Those of the reader; raised here together with those of the points.
        assumptions: What the reader assumed, a sentence each.
        passed_over: What it passed over, likewise.
        unit: Of the file's positions.
        unit_in_file: Whether the file states it.

    Raises:
        InvalidInput: If there is no point, one is too far away or too fast, or a direction is zero.
    """
    if not curves:
        problems.refuse()
        raise InvalidInput("there is no point in it.")
    _refuse_far(curves, problems, unit, unit_in_file=unit_in_file)
    found: list[Curve] = []
    repeated: list[int] = []
    for number, (points, *ways) in enumerate(curves, start=1):
        feeds = _feeds(points, problems)
        curve = _curve(orientation, points, points.name or str(number), call, problems, feeds)
        again = _repeats(curve)
        repeated += curve.lines[again].tolist()
        before, after = (way and _curve(orientation, way, "", call, problems) for way in ways)
        found.append(replace(curve.part(~again), before=before, after=after))
    problems.refuse()
    whole = orientation in ("quaternion", "rpy", "rotation_vector", "matrix")
    meaning: Meaning = "rotation" if whole else orientation  # type: ignore[assignment]
    dropped = []
    if repeated:
        many = len(repeated)
        what = "a point that repeats" if many == 1 else f"{many} points that repeat"
        were, where = ("was", "line") if many == 1 else ("were", "the first in line")
        dropped = [f"{what} the one before {were} dropped ({where} {repeated[0]})."]
    return Toolpath(
        path, meaning, tuple(found), tuple(assumptions), (*passed_over, *dropped), unit,
        unit_in_file,
    )  # fmt: skip


class UnitQuestion(NamedTuple):
    """Whether a file is in another unit, in words without a full stop, and options that say so.

    ``likely`` is the unit in which it is small enough. A file that states its unit has no options.
    """

    text: str
    likely: LengthUnit | None
    options: dict[str, str | None]

    @classmethod
    def of(cls, unit: LengthUnit, size: float, most: float, *, unit_in_file: bool) -> UnitQuestion:
        """About a file of a size (m) above ``most`` (m)."""
        factors = {other: LENGTHS[other] / LENGTHS[unit] for other in LENGTHS}
        likely = next((u for u, f in factors.items() if f < 1.0 and f * size <= most), None)
        if likely is None:
            return cls("in no unit that is known would it be small enough", None, {})
        if unit_in_file:
            how = f"the file says {unit}, so write {likely} there"
            return cls(f"is the file in {likely}? {how}", likely, {})
        how = f'if it is, say length_unit = "{likely}"'
        return cls(f"is the file in {likely}? {how}", likely, {"length_unit": likely})


def _refuse_far(
    curves: Sequence[PointsOfCurve], problems: Problems, unit: LengthUnit, *, unit_in_file: bool
) -> None:
    """Report all points that are too far away as one problem: a wrong unit."""
    parts = [part for points, before, after in curves for part in (before, points, after) if part]
    apart = np.concatenate([np.abs(part.positions).max(axis=1) for part in parts])
    far = np.flatnonzero(apart > LARGEST_COORDINATE)
    if len(far):
        line = np.concatenate([part.lines for part in parts])[far[0]]
        more = f", and {len(far) - 1} points more are as far" if len(far) > 1 else ""
        question = UnitQuestion.of(
            unit, float(apart.max()), LARGEST_COORDINATE, unit_in_file=unit_in_file
        )
        problems.add(
            int(line),
            f"the point is {apart[far[0]]:.4g} m from the origin of its file, more than "
            f"{LARGEST_COORDINATE:g} m{more}; {question.text}",
            options=question.options,
        )


def _feeds(points: Points, problems: Problems) -> Array | None:
    """Feeds of the motions to the points, NaN for the first one of a curve."""
    feeds = points.feeds.copy()
    feeds[0] = np.nan
    fast = np.flatnonzero(feeds > LARGEST_FEED)
    if len(fast):
        many = f" (and to {len(fast) - 1} points more)" if len(fast) > 1 else ""
        problems.add(
            int(points.lines[fast[0]]),
            f"the feed to this point{many} is {feeds[fast[0]]:.4g} m/s, more than "
            f"{LARGEST_FEED:g} m/s; check its unit",
        )
    return feeds if np.isfinite(feeds).any() else None


def _curve(
    orientation: Orientation,
    points: Points,
    name: str,
    call: str,
    problems: Problems,
    feeds: Array | None = None,
) -> Curve:
    from scipy.spatial.transform import Rotation  # imported on demand: 0.1 s

    values, vectors, rotations = points.directions, None, None
    match orientation:
        case "axis" | "normal":
            vectors = _unit_vectors(orientation, points, call, problems)
            if values.shape[1] == 6:
                rotations, vectors = _frames(vectors, points, call, problems), None
        case "quaternion":
            units = _unit_vectors(orientation, points, call, problems)
            rotations = Rotation.from_quat(units, scalar_first=True).as_matrix()
        case "rpy":
            rotations = Rotation.from_euler("xyz", values).as_matrix()
        case "rotation_vector":
            rotations = Rotation.from_rotvec(values).as_matrix()
        case "matrix":
            rotations = np.clip(values.reshape(-1, 3, 3), -2.0, 2.0)
            off = np.abs(rotations @ rotations.transpose(0, 2, 1) - np.eye(3)).max(axis=(1, 2))
            wrong = (off > 0.01) | (np.linalg.det(rotations) < 0.0)
            for line in points.lines[wrong].tolist():
                problems.add(line, "the matrix is no rotation; check which columns it is in", call)
            rotations[wrong] = np.eye(3)
            rotations = Rotation.from_matrix(rotations).as_matrix()
    return Curve(name, points.positions, vectors, rotations, points.lines, feeds)


def _unit_vectors(orientation: str, points: Points, call: str, problems: Problems) -> Array:
    """The directions, normalised; those of length zero are problems."""
    values = points.directions[:, :3] if orientation != "quaternion" else points.directions
    lines = points.lines.tolist()
    largest = np.abs(values).max(axis=1, keepdims=True)  # squares of tiny numbers are zero
    nothing = largest[:, 0] < 1e-12
    for k in np.flatnonzero(nothing):
        problems.add(lines[k], f"the {orientation} is zero and has no direction", call)
    units: Array = np.where(nothing[:, None], 1.0, values / np.where(nothing[:, None], 1, largest))
    lengths = np.linalg.norm(units, axis=1)
    units /= lengths[:, None]
    if orientation == "quaternion":
        lengths *= largest[:, 0]
        for k in np.flatnonzero((np.abs(lengths - 1.0) > 0.01) & ~nothing):
            problems.add(
                lines[k],
                f"the quaternion has the length {lengths[k]:.4g} instead of 1; check which columns "
                "it is in",
                call,
            )
    return units


def _frames(axes: Array, points: Points, call: str, problems: Problems) -> Array:
    """Rotations whose z are some axes, and whose x are nearest to a second direction."""
    second = points.directions[:, 3:]
    x = second - (second * axes).sum(axis=1, keepdims=True) * axes
    lengths = np.linalg.norm(x, axis=1)
    parallel = ~(lengths > 1e-6 * np.linalg.norm(second, axis=1))
    for line in points.lines[parallel].tolist():
        problems.add(line, "the second axis is zero, or parallel to the first", call)
    x[parallel], lengths[parallel] = perpendicular(axes[parallel]), 1.0
    x /= lengths[:, None]
    return np.stack([x, np.cross(axes, x), axes], axis=-1)


def _repeats(curve: Curve) -> Mask:
    """Which points repeat the one before, (N,)."""
    same = np.linalg.norm(np.diff(curve.positions, axis=0), axis=1) < SAME_POINT
    if curve.vectors is not None:
        same &= angles_between(curve.vectors[:-1], curve.vectors[1:]) < SAME_DIRECTION
    if curve.rotations is not None:
        same &= turns_between(curve.rotations[:-1], curve.rotations[1:]) < SAME_DIRECTION
    return np.concatenate([[False], same])
