"""Resample a curve: fewer points where it is straight, more where it is coarse."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt

from qp_twist.checks import Array, Mask
from qp_twist.errors import InvalidInput
from qp_twist.paths.toolpath import Curve
from qp_twist.paths.turning import angles_between, rotations_at, turns_between, vectors_at

_At = Callable[[Array, Array, Array], Array]
_Apart = Callable[[Array, Array], Array]
CORNER = math.radians(30.0)
"""A point where the path turns by more than this is kept."""
FLAT = math.radians(179.0)
"""Between neighbours turned by more than this, the direction of rotation is ambiguous."""
MOST = 200_000
"""Largest number of waypoints of a curve; more indicate a wrong setting."""


@dataclass(frozen=True)
class Sampling:
    """Sampling of a curve.

    Attributes:
        chord_error: Largest distance between the given path and the new one, m; ``None`` keeps
            every given point.
        axis_error: Largest angle, at a point left out, between its direction and the one
            interpolated there, rad.
        max_turn: Largest turn of the direction from a waypoint to the next, rad.
        max_spacing: Largest distance from a waypoint to the next, m.
    """

    chord_error: float | None = None
    axis_error: float = math.radians(0.1)
    max_turn: float = math.radians(3.0)
    max_spacing: float = 0.01


def resampled(curve: Curve, sampling: Sampling, stays: Mask | None = None) -> Curve:
    r"""The curve with other points on it.

    First, points are left out if they are nearer than ``chord_error`` to the chord between their
    kept neighbours, and the direction interpolated over the arc length differs there by less than
    ``axis_error``. The distance from a chord is a convex function along the path, so the whole path
    is as near. Ends, corners, points where the tool turns in place and points where the feed
    changes are kept, as are those that ``stays`` (N,). Then every chord is divided into

    .. math:: \max\left(\left\lceil \frac{\ell}{\text{max\_spacing}} \right\rceil,
        \left\lceil \frac{\theta}{\text{max\_turn}} \right\rceil\right)

    equal steps, with directions on the great circle between its ends.

    Returns:
        The new curve; a new point has the line of the given one before it.

    Raises:
        InvalidInput: If neighbouring directions are opposite, or there are too many waypoints.
    """
    if len(curve) < 2:
        return curve
    _refuse_opposite(curve)
    kept = np.arange(len(curve))
    if sampling.chord_error is not None:
        kept = np.flatnonzero(_kept(curve, sampling.chord_error, sampling.axis_error, stays))
    return _divided(curve, kept, sampling)


def _refuse_opposite(curve: Curve) -> None:
    flat = _turns(curve, np.arange(len(curve))) > FLAT
    if flat.any():
        first = int(np.argmax(flat))
        more = f", and in {flat.sum() - 1} places more" if flat.sum() > 1 else ""
        raise InvalidInput(
            f"the direction is turned round from line {curve.lines[first]} to line "
            f"{curve.lines[first + 1]}{more}, and which way the tool should turn is open; give a "
            "direction in between, or correct the sign."
        )


def _directions(curve: Curve) -> tuple[Array | None, _At, _Apart]:
    """Directions (N, 3) or (N, 3, 3), their interpolation, and the angles between them."""
    if curve.vectors is not None:
        return curve.vectors, vectors_at, angles_between
    return curve.rotations, rotations_at, turns_between


def _turns(curve: Curve, kept: npt.NDArray[np.intp]) -> Array:
    """Angles from each of some points to the next, rad."""
    values, _, apart = _directions(curve)
    if values is None:
        return np.zeros(len(kept) - 1)
    return apart(values[kept[:-1]], values[kept[1:]])


def _kept(curve: Curve, chord_error: float, axis_error: float, kept: Mask | None) -> Mask:
    """Which points are kept: a chord is split at its worst point until it fits."""
    steps = np.diff(curve.positions, axis=0)
    lengths = np.linalg.norm(steps, axis=1)
    arc = np.concatenate([[0.0], np.cumsum(lengths)])
    stays = np.zeros(len(curve), dtype=np.bool_) if kept is None else kept.copy()
    stays[[0, -1]] = True
    standing = lengths < 1e-9
    stays[:-1] |= standing
    stays[1:] |= standing
    units = steps / np.where(standing, 1.0, lengths)[:, None]
    stays[1:-1] |= angles_between(units[:-1], units[1:]) > CORNER
    if curve.feeds is not None:
        feeds = np.nan_to_num(curve.feeds, nan=-1.0)
        stays[1:-1] |= feeds[1:-1] != feeds[2:]
    fixed = np.flatnonzero(stays)
    spans = list(zip(fixed[:-1].tolist(), fixed[1:].tolist(), strict=True))
    while spans:
        a, b = spans.pop()
        if b - a < 2:
            continue
        # Relative to what is allowed, so that one number says whether and where to split.
        excess = np.maximum(
            _off_chord(curve.positions, a, b) / chord_error,
            _off_direction(curve, arc, a, b) / axis_error,
        )
        worst = int(np.argmax(excess))
        if excess[worst] > 1.0:
            middle = a + 1 + worst
            stays[middle] = True
            spans += [(a, middle), (middle, b)]
    return stays


def _off_chord(positions: Array, a: int, b: int) -> Array:
    """Distances of the points between a and b from the chord from a to b, m."""
    chord = positions[b] - positions[a]
    inner = positions[a + 1 : b] - positions[a]
    square = float(chord @ chord)
    along = np.clip(inner @ chord / square, 0.0, 1.0) if square > 0.0 else np.zeros(len(inner))
    return np.asarray(np.linalg.norm(inner - along[:, None] * chord, axis=1))


def _off_direction(curve: Curve, arc: Array, a: int, b: int) -> Array:
    """Angles between the directions of the points between a and b and those interpolated, rad."""
    shares = (arc[a + 1 : b] - arc[a]) / (arc[b] - arc[a])
    values, at, apart = _directions(curve)
    if values is None:
        return np.zeros(len(shares))
    if apart(values[a : a + 1], values[b : b + 1])[0] > FLAT:
        return np.full(len(shares), np.inf)
    return apart(at(values[a], values[b], shares), values[a + 1 : b])


def _divided(curve: Curve, kept: npt.NDArray[np.intp], sampling: Sampling) -> Curve:
    """The chords between the kept points, each in equal steps."""
    lengths = np.linalg.norm(np.diff(curve.positions[kept], axis=0), axis=1)
    turns = _turns(curve, kept)
    # A step longer by a rounding error is no reason for another one.
    wanted = np.maximum(lengths / sampling.max_spacing, turns / sampling.max_turn) * (1.0 - 1e-9)
    if wanted.sum() > MOST:
        raise InvalidInput(
            f"max_spacing = {sampling.max_spacing:g} m and max_turn_deg = "
            f"{math.degrees(sampling.max_turn):g} make {wanted.sum():.3g} waypoints of curve "
            f"{curve.name!r}, which is {lengths.sum():.3g} m long; at most {MOST} are made."
        )
    counts = np.maximum(np.ceil(wanted).astype(np.int64), 1)
    chord = np.repeat(np.arange(len(counts)), counts)
    first = np.cumsum(counts) - counts
    shares = (np.arange(len(chord)) - first[chord]) / counts[chord]
    begin, end = kept[chord], kept[chord + 1]

    def with_last(points: Array, values: Array) -> Array:
        # Kept points are copied, so that interpolation does not round them.
        given = shares == 0.0
        points[given] = values[begin[given]]
        return np.concatenate([points, values[-1:]])

    positions, feeds = curve.positions, curve.feeds
    between = positions[begin] + shares[:, None] * (positions[end] - positions[begin])
    values, at, _ = _directions(curve)
    if values is not None:
        values = with_last(at(values[begin], values[end], shares), values)
    vectors, rotations = (None, values) if curve.vectors is None else (values, None)
    lines = np.concatenate([curve.lines[begin], curve.lines[-1:]])
    feeds = None if feeds is None else with_last(feeds[end], feeds)
    return replace(
        curve, positions=with_last(between, positions), vectors=vectors, rotations=rotations,
        lines=lines, feeds=feeds, before=None, after=None,
    )  # fmt: skip
