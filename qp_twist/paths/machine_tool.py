"""The machine that programs of machine tools steer: where its tool is, and how it gets on."""

from __future__ import annotations

import copy
import math
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from itertools import pairwise
from pathlib import Path
from typing import NamedTuple

import numpy as np

from qp_twist.checks import Array
from qp_twist.errors import InvalidInput
from qp_twist.paths.arcs import LARGEST_TURN, Arc, cross, cut_corner
from qp_twist.paths.program_block import Block
from qp_twist.paths.program_facts import Facts
from qp_twist.paths.program_frame import Frame
from qp_twist.paths.tool_axis import BY_VECTOR, ToolAxis
from qp_twist.paths.toolpath import SAME_POINT, Toolpath
from qp_twist.paths.toolpath_builder import ProgramBuilder

_LARGEST_STEP = 3.0
"""Rotary axes move in proportion; the tool axis is computed at least every this many degrees."""
_TWO_CUTS = "a corner is cut between two straight cuts alone"


class Hole(NamedTuple):
    """A hole along z: the tool goes near it, down to its bottom, and back.

    Attributes:
        near: Height at which the feed begins, m.
        bottom: Height of the bottom, m.
        above: Height at which the tool comes and goes, m.
        out_at_feed: Whether it comes back at the feed, and not rapidly.
        feed: m per minute or turn, and whether per turn, if the cycle states one.
    """

    near: float
    bottom: float
    above: float
    out_at_feed: bool = False
    feed: tuple[float, bool] | None = None

    def motions(self) -> Iterator[tuple[float, bool]]:
        """Where each motion ends, m, and whether it is rapid."""
        yield self.near, True
        yield self.bottom, False
        yield self.near, not self.out_at_feed
        if self.above > self.near:
            yield self.above, True


class Corner(NamedTuple):
    """A corner that the next motion ends.

    Attributes:
        kind: ``R``, ``C`` or ``CHF``, as for :func:`~qp_twist.paths.arcs.cut_corner`.
        size: m.
        modal: Whether each corner is cut, where there is one.
        feed: In the corner, m per minute or turn, and whether per turn; if it has its own.
    """

    kind: str
    size: float
    modal: bool = False
    feed: tuple[float, bool] | None = None


class Cut(NamedTuple):
    """A straight cut, and the largest turn of a rotary axis on its way, degrees."""

    start: dict[str, float]
    end: dict[str, float]
    turn: float


class MachineTool:
    """The tool on its way.

    Attributes:
        out: The points so far.
        axis: The tool axis by rotary axes or vectors.
        frame: Of the coordinates.
        at: Where the tool is in it: X, Y, Z, m, as far as they are known.
        gone: Axes along which it is somewhere unknown; along others it begins at 0.
        tip: Whether the coordinates are those of the tip, whatever the tool axis.
        tilted: Whether there was a tilted plane.
        corner: At the end of the last cut.
        last: The last cut.
    """

    def __init__(self, out: ProgramBuilder, facts: Facts, *, assumes: bool) -> None:
        """``assumes``: of what nothing states, where axes begin and where a fourth one is."""
        self.out, self.axis, self.frame = out, ToolAxis(out, facts), Frame()
        self.at: dict[str, float] = {}
        self.gone: set[str] = set("" if assumes else "XYZ")
        self.tip = self.tilted = False
        self.corner: Corner | None = None
        self.last: Cut | Arc | None = None
        self._assumes = assumes
        self._stated = facts.stated & {"X", "Y", "Z"}  # somewhere in the program

    # ------------------------------------------------------------ where the tool is

    def scale(self) -> float:
        """Metres in the unit of coordinates."""
        return self.out.scale()

    def point(self) -> Array:
        """Where the tool is, m, (3,)."""
        if missing := [axis for axis in "XYZ" if axis not in self.at]:
            raise InvalidInput(f"where the tool is in {' and '.join(missing)} is not known")
        return _point(self.at)

    def leave(self, axes: Iterable[str]) -> None:
        """The tool goes to an unknown place along some axes: another curve begins there."""
        self._forget(axes)
        self.last = None
        self.out.rows.begin_curve()

    def _forget(self, axes: Iterable[str]) -> None:
        self.gone.update(axes)
        self.at = {axis: value for axis, value in self.at.items() if axis not in self.gone}

    def reframe(self, frame: Frame) -> None:
        """The frame of the coordinates changes; the tool stays where it is."""
        before, self.frame = self.frame.whole, frame
        self.tilted |= frame.plane is not None
        self.last = None
        if len(self.at) == 3:
            there = frame.whole.inv().apply(before.apply(_point(self.at)))
            self.at = dict(zip("XYZ", there.tolist(), strict=True))
        elif np.any(frame.whole.as_matrix() != before.as_matrix()):
            self._forget(self.at)

    def assume_zero(self, axis: str, word: str) -> None:
        """Where nothing states a coordinate, machines begin at 0."""
        if axis in self.gone:
            raise InvalidInput(f"{word}: where the tool is in {axis} is not known")
        self.at = {**self.at, axis: 0.0}
        self.out.note(f"{axis} is 0 until it is stated")

    def target(self, block: Block) -> None:
        """Read X, Y and Z: the tool is there then."""
        at, words, scale = dict(self.at), block.words, 0.0
        for axis in "XYZ":
            if axis not in words:
                continue
            scale = scale or self.scale()
            value = scale * words[axis]
            if block.relative(axis):
                if axis in self.gone and axis not in at:
                    raise InvalidInput(f"{axis} is relative to a position that is not known")
                if axis not in at:
                    self.assume_zero(axis, axis)
                value += at.get(axis, 0.0)
            at[axis] = value
        self.at = at
        self.gone.difference_update(at)

    def polar(
        self, block: Block, radius: str, angle: str, pole: Array, axes: tuple[int, int]
    ) -> None:
        """Write a target by the words of a radius and an angle about a pole as coordinates."""
        first, second = ("XYZ"[k] for k in axes)
        stated = all(k in block.words and not block.relative(k) for k in (radius, angle))
        if not stated and not {first, second} <= self.at.keys():
            raise InvalidInput(f"where the tool is in {first} and {second} is not known")
        u, v = (self.at.get("XYZ"[k], 0.0) - float(pole[k]) for k in axes)
        scale, found = self.scale(), []
        for name, before, unit in (
            (radius, math.hypot(u, v), scale),
            (angle, math.atan2(v, u), math.radians(1.0)),
        ):
            kept = before if block.relative(name) or name not in block.words else 0.0
            found.append(kept + unit * block.words.pop(name, 0.0))
        ways = found[0] * math.cos(found[1]), found[0] * math.sin(found[1])
        for letter, k, way in zip((first, second), axes, ways, strict=True):
            block.take(letter, (float(pole[k]) + way) / scale)
            block.kinds[letter] = "AC"

    # ------------------------------------------------------------ motions

    def line(self, block: Block, *, cut: bool) -> None:
        """A straight motion to the target of a block, over which rotary axes move in proportion."""
        start, begin, read = self._lead("", block, cut=cut)
        self.axis.read_vector(block)
        if not read:
            self._without_tip(cut=cut)
        elif len(self.at) == 3:
            self.straight(start, begin, cut=cut)

    def arc(
        self, word: str, block: Block, arc_of: Callable[[Array, Array], Arc | None], *,
        cut: bool = True,
    ) -> None:  # fmt: skip
        """An arc or a helix to the target of a block, by a function of its start and its end."""
        start, begin, read = self._lead(word, block, cut=cut)
        if not read:
            self._without_tip(cut=cut)
            return
        if len(start) < 3 or len(self.at) < 3:
            raise InvalidInput(f"{word}: where the arc begins is not known")
        if not block.words.keys().isdisjoint(BY_VECTOR):
            raise InvalidInput("a tool axis by A3, B3, C3 on an arc is not read")
        arc = arc_of(_point(start), _point(self.at))
        if arc is None:
            self.straight(start, begin, cut=cut)
            return
        if self.corner is not None:
            self.corner = None
            raise InvalidInput(_TWO_CUTS)
        self._add(*self.out.divide_arc(arc), begin, cut=cut)
        self.at, self.last = dict(zip("XYZ", arc.end.tolist(), strict=True)), arc

    def bore(self, hole: Hole, begin: dict[str, float] | None = None) -> None:
        """The motions of a hole where the tool is."""
        with self._own_feed("F of a cycle", hole.feed):
            for height, rapid in hole.motions():
                start, self.at = self.at, {**self.at, "Z": height}
                self.straight(start, begin or {}, cut=not rapid)

    @contextmanager
    def _own_feed(self, word: str, feed: tuple[float, bool] | None) -> Iterator[None]:
        """Motions at a feed of their own, if there is one."""
        feeds, self.out.feeds = self.out.feeds, copy.copy(self.out.feeds)
        if feed is not None:
            self.out.feeds.state(word, feed[0], 1.0, per_turn=feed[1])
        try:
            yield
        finally:
            self.out.feeds = feeds

    def heading(self) -> Array | None:
        """The direction at the end of the last cut, (3,), if there is one."""
        if self.last is None:
            return None
        if isinstance(self.last, Arc):
            way = cross(self.last.axis, self.last.end - self.last.centre)
        else:
            way = _point(self.last.end) - _point(self.last.start)
        return np.asarray(way / np.linalg.norm(way))

    def toolpath(self, path: Path) -> Toolpath:
        """The whole toolpath, with what was assumed."""
        has_axis = self.axis.stated or self.tilted
        return self.out.toolpath(path, self.axis.notes(), has_axis=has_axis)

    def _lead(
        self, word: str, block: Block, *, cut: bool
    ) -> tuple[dict[str, float], dict[str, float], bool]:
        """Read where a motion leads: its start, the angles there, and whether it can be read.

        An arc has a word for messages; a straight cut from an unknown place is left out.
        """
        axis, start = self.axis, self.at
        moves = not block.words.keys().isdisjoint("XYZ")
        tip = self.tip or self.frame.plane is not None
        if not tip and not axis.machine and axis.turned and not moves:
            self._forget("XYZ")  # a turn about the pivot of the machine leads the tip elsewhere
        relative = any(map(block.relative, "XYZ"))
        self.target(block)
        begin = axis.turn(block, cut=cut)
        if self._assumes and not tip and axis.turned and axis.rotary is not None:
            axis.assume_machine()
        unread = not tip and axis.turned and not axis.machine
        missing = {"X", "Y", "Z"} - self.at.keys()
        unknown = missing & (self.gone if relative else self.gone | self._stated)
        straight = cut and not word and not unread
        from_nowhere = moves and not missing and len(start) < 3 and not relative
        if straight and (unknown or from_nowhere):
            self.out.note("cuts are left out while it is not known where the tool comes from")
        if straight and unknown:
            self.out.rows.begin_curve()
        elif cut and missing and moves and not unread:
            for name in sorted(missing):
                self.assume_zero(name, word or "G1")
                start = {**start, name: 0.0}
            if len(start) == 3:
                self._add(_point(start)[None], np.ones(1), begin, cut=False)
        return start, begin, not unread or axis.rotary is None

    def _without_tip(self, *, cut: bool) -> None:
        """A motion with turned rotary axes whose X, Y, Z are not those of the tip."""
        self.leave("XYZ")
        if cut:
            self.axis.refuse_without_tip()

    def straight(self, start: dict[str, float], begin: dict[str, float], *, cut: bool) -> None:
        """Add a straight motion to where the tool is, divided where rotary axes turn it."""
        turn, end = self.axis.largest_turn(begin), _point(self.at)
        if self.corner is not None:
            self._finish_corner(begin, cut=cut and not turn)
        points, shares = end[None], np.ones(1)
        if turn and cut and len(start) == 3:
            # In rapid motion the way of the axis does not matter, and it is one motion.
            if turn > LARGEST_TURN:
                raise InvalidInput(
                    f"a rotary axis turns by {turn:.6g} degrees in one cut, more than "
                    f"{LARGEST_TURN:g}; check the angle"
                )
            first = _point(start)
            step = min(_LARGEST_STEP, self.axis.largest_step(first, end, tip=self._of_tip()))
            count = max(1, math.ceil(turn / step - 1e-9))
            if count > 1:
                shares = np.arange(1, count + 1) / count
                points = first + shares[:, None] * (end - first)
                points[-1] = end
        self._add(points, shares, begin, cut=cut)
        if not cut or len(start) < 3:
            self.last = None
        elif start != self.at:
            self.last = Cut(start, self.at, turn)

    def _finish_corner(self, begin: dict[str, float], *, cut: bool) -> None:
        """Shorten the cut before a corner, and cut the corner on the way to where the tool is."""
        corner, self.corner = self.corner, None
        assert corner is not None
        if corner.modal and not cut:
            return
        if not cut or not isinstance(self.last, Cut) or self.last.turn:
            raise InvalidInput(_TWO_CUTS)
        first, motion = cut_corner(
            _point(self.last.start), _point(self.last.end), _point(self.at), *corner[:2]
        )
        if motion is None:
            return
        moved = self.frame.whole.apply(first) if self.frame.changed else first
        self.out.rows[-1].positions[-1] = moved
        with self._own_feed("the feed of a corner", corner.feed):
            if corner.kind == "R":
                self._add(*self.out.divide_arc(motion), begin, cut=True)
            else:
                self._add(motion.end[None], np.ones(1), begin, cut=True)

    # ------------------------------------------------------------ points

    def _of_tip(self) -> bool:
        """Whether X, Y, Z are those of the tip."""
        return self.tip or self.frame.plane is not None or not self.axis.machine

    def _direction(self, begin: dict[str, float], share: float) -> tuple[float, ...]:
        """The tool axis at a share of a motion, in the part's frame; vectors turn with it."""
        if self.frame.axis is not None:
            return self.frame.axis
        direction = self.axis.at(begin, share)
        if self.axis.vector is not None and self.frame.turned:
            return tuple(self.frame.whole.rotation.apply(direction).tolist())
        return direction

    def _add(self, points: Array, shares: Array, begin: dict[str, float], *, cut: bool) -> None:
        """Add the points of a motion at some shares of it; in a cut those that differ."""
        rows, of_shares = self.out.rows, shares.tolist()
        if begin is self.axis.angles:
            directions = [self._direction(begin, 1.0)] * len(of_shares)
        else:
            directions = [self._direction(begin, share) for share in of_shares]
        if not self._of_tip():
            stations = zip(of_shares, points.tolist(), strict=True)
            points = np.array([self.axis.tip(begin, share, point) for share, point in stations])
        if self.frame.changed:
            points = self.frame.whole.apply(points)
        if rows and cut:
            ways = pairwise([rows[-1].positions[-1].tolist(), *points.tolist()])
            lengths = [math.dist(one, other) for one, other in ways]
            turns = pairwise([rows[-1].directions[-1], *directions])
            keep = [k for k, (one, other) in enumerate(turns)
                    if lengths[k] >= SAME_POINT or one != other]  # fmt: skip
            self.out.feeds.take_motion(sum(lengths))
            if len(keep) < len(points):
                points, directions = points[keep], [directions[k] for k in keep]
        self.out.add(points, directions, rapid=not cut)  # type: ignore[arg-type]


def _point(at: dict[str, float]) -> Array:
    return np.array([at["X"], at["Y"], at["Z"]])
