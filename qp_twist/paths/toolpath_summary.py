"""What a toolpath file says at a glance: extent, lengths, feeds, the longest step and turn."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from qp_twist.checks import Array, Mask
from qp_twist.paths.toolpath import Curve, Lines, Toolpath
from qp_twist.paths.turning import angles_between


class ToolMotion(NamedTuple):
    """All points of a toolpath in the order in which the tool passes them.

    Attributes:
        positions: m, (N, 3).
        axes: Tool axes or surface normals, unit, (N, 3); NaN where the file has none.
        lines: Lines of the file, from 1, (N,).
        feeds: Of the motion to each point, m/s, (N,); NaN without one.
        cut: Whether the motion to each point is along a curve, (N,): all others are in rapid
            motion, from curve to curve, or lead to the first point.
    """

    positions: Array
    axes: Array
    lines: Lines
    feeds: Array
    cut: Mask

    @property
    def steps(self) -> Array:
        """Lengths of the motions to each point, m, (N,); the first is 0."""
        moved = np.linalg.norm(np.diff(self.positions, axis=0), axis=1)
        return np.insert(moved, 0, 0.0)

    @property
    def turns(self) -> Array:
        """Angles by which the axis turns on the way to each point, rad, (N,); NaN without axes."""
        turns = angles_between(self.axes[:-1], self.axes[1:])
        return np.insert(turns, 0, np.nan if np.isnan(turns).any() else 0.0)


class Largest(NamedTuple):
    """The largest of some values along a toolpath, and where it is."""

    value: float
    line: int


class ToolpathSummary(NamedTuple):
    """A toolpath in numbers.

    Attributes:
        curves: Number of its curves.
        points: Number of their points.
        low: Least coordinates of the curves' points, m, (3,).
        high: Largest ones, m, (3,).
        cut: Length of the curves, m.
        rapids: Length of the ways between them, and of all rapid motions, m.
        feeds: Lowest and highest feed of the curves, m/s; ``None`` if the file has none.
        time: Of the curves at these feeds, s; ``None`` unless each of their points has one.
        longest_step: Longest motion between two points of a curve, m; ``None`` without one.
        largest_turn: Largest angle by which the axis turns in one of them, rad; ``None`` also if
            the file has no axes.
        tilt: Least and largest angle between the axes and z of the file, rad; ``None`` likewise.
    """

    curves: int
    points: int
    low: Array
    high: Array
    cut: float
    rapids: float
    feeds: tuple[float, float] | None
    time: float | None
    longest_step: Largest | None
    largest_turn: Largest | None
    tilt: tuple[float, float] | None


def tool_motion(toolpath: Toolpath) -> ToolMotion:
    """The motion of the tool through a whole file."""
    pieces: list[tuple[Curve, bool]] = []
    for curve in toolpath.curves:
        for piece, cut in ((curve.before, False), (curve, True), (curve.after, False)):
            if piece is not None:
                pieces.append((piece, cut))
    along = [np.full(len(piece), cut) for piece, cut in pieces]
    for mask in along:
        mask[:1] = False  # a way leads to the first point of a curve
    return ToolMotion(
        np.concatenate([piece.positions for piece, _ in pieces]),
        np.concatenate([piece.axes for piece, _ in pieces]),
        np.concatenate([piece.lines for piece, _ in pieces]),
        np.concatenate([_feeds(piece) for piece, _ in pieces]),
        np.concatenate(along),
    )


def summarize(toolpath: Toolpath) -> ToolpathSummary:
    """A toolpath in numbers."""
    motion = tool_motion(toolpath)
    steps, turns, cut = motion.steps, motion.turns, motion.cut
    positions = np.concatenate([curve.positions for curve in toolpath.curves])
    cosines = np.concatenate([curve.axes[:, 2] for curve in toolpath.curves])
    has_axes = not np.isnan(cosines).any()
    tilts = np.arccos(np.clip(cosines, -1.0, 1.0))
    timed = bool(cut.any()) and bool(np.isfinite(motion.feeds[cut]).all())
    return ToolpathSummary(
        len(toolpath.curves), len(positions), positions.min(axis=0), positions.max(axis=0),
        float(steps[cut].sum()), float(steps[~cut].sum()), toolpath.feeds,
        float((steps[cut] / motion.feeds[cut]).sum()) if timed else None,
        _largest(steps, motion, cut),
        _largest(turns, motion, cut & np.isfinite(turns)) if has_axes else None,
        (float(tilts.min()), float(tilts.max())) if has_axes else None,
    )  # fmt: skip


def _feeds(curve: Curve) -> Array:
    return np.full(len(curve), np.nan) if curve.feeds is None else curve.feeds


def _largest(values: Array, motion: ToolMotion, among: Mask) -> Largest | None:
    if not among.any():
        return None
    at = int(np.flatnonzero(among)[np.argmax(values[among])])
    return Largest(float(values[at]), int(motion.lines[at]))
