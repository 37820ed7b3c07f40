"""The motions of a G-code program: where the tool is, and which points lead there."""

from __future__ import annotations

import math
from collections.abc import Iterator
from contextlib import contextmanager

import numpy as np

from qp_twist.checks import Array
from qp_twist.errors import InvalidInput
from qp_twist.paths.arcs import Arc
from qp_twist.paths.gcode_arcs import axis_of, centre_of
from qp_twist.paths.gcode_corners import corner_of, cut_corner
from qp_twist.paths.gcode_facts import Facts
from qp_twist.paths.gcode_frames import Frames
from qp_twist.paths.gcode_modes import Modes
from qp_twist.paths.gcode_tool_axis import BY_VECTOR, ToolAxis
from qp_twist.paths.gcode_words import Block
from qp_twist.paths.toolpath import SAME_POINT
from qp_twist.paths.toolpath_builder import ProgramBuilder, of_lines

_LARGEST_TURN = 3.0
"""Rotary axes move in proportion; the tool axis is computed at least every this many degrees."""
_MOST_TURNED = 36_000.0
"""Largest turn of a rotary axis in one cut, degrees: beyond it, a number is wrong."""


class Motions:
    """Where the tool is, and the points that its motions add.

    Attributes:
        out: The points so far.
        facts: What the whole program says.
        axis: The tool axis.
        modes: What holds.
        frames: Of X, Y, Z.
        at: Where the tool is: X, Y, Z in m as far as they are known.
        gone: Axes that a position of the machine, or a turn, led to an unknown place.
    """

    def __init__(self, out: ProgramBuilder, facts: Facts) -> None:
        self.out, self.facts = out, facts
        self.axis = ToolAxis(out, facts)
        self.modes, self.frames = Modes(), Frames()
        self.at: dict[str, float] = {}
        self.gone: set[str] = set()
        self._notes: dict[str, list[int]] = {}
        self._corner: tuple[Array, Array, tuple[str, float]] | None = None
        self._motions_per_minute: float | None = None

    @property
    def notes(self) -> list[str]:
        """What was assumed, a sentence each, with its lines."""
        return [f"{what} ({of_lines(lines)})." for what, lines in self._notes.items()]

    def note(self, what: str) -> None:
        """Note an assumption of the current line."""
        self._notes.setdefault(what, []).append(self.out.line)

    def scale(self) -> float:
        """Metres in the unit of a number."""
        least = 1e-3 if self.out.length_unit == "mm" else 1e-4
        return self.out.scale() * (least if self.facts.in_thousandths else 1.0)

    def target(self, block: Block, scale: float) -> None:
        """Read X, Y and Z of a block.

        Raises:
            InvalidInput: If one is relative to a position that is not known.
        """
        for axis in "XYZ":
            if axis not in block.words:
                continue
            kind = block.kinds.get(axis, "IC" if self.modes.relative else "AC")
            if kind == "IC" and axis not in self.at:
                if axis in self.gone:
                    raise InvalidInput(f"{axis} is relative (G91) to a position that is not known")
                self.assume_zero(axis)
            value = scale * block.words[axis]
            self.at[axis] = value + self.at[axis] if kind == "IC" else value

    def assume_zero(self, axis: str) -> None:
        """Where nothing states a coordinate, machines begin at 0.

        Raises:
            InvalidInput: If the tool went elsewhere.
        """
        if axis in self.gone:
            raise InvalidInput(
                f"G{self.modes.motion or 0}: where the tool is in {axis} is not known"
            )
        self.at[axis] = 0.0
        self.note(f"{axis} is 0 until it is stated")

    @contextmanager
    def reframed(self) -> Iterator[Frames]:
        """While it is open, the frame of the coordinates changes; the tool stays where it is."""
        before = self.frames.whole
        yield self.frames
        after = self.frames.whole
        if len(self.at) == 3:
            there = after.inv().apply(before.apply(_point(self.at)))
            self.at = dict(zip("XYZ", there.tolist(), strict=True))
        elif np.any(after.as_matrix() != before.as_matrix()):
            self.gone.update(self.at)
            self.at.clear()

    def leave(self, words: dict[str, float]) -> None:
        """A motion to a position of the machine: the axes it names are somewhere unknown."""
        named = set("XYZ") & words.keys()
        for axis in named or ({} if set("ABC") & words.keys() else "XYZ"):
            self.at.pop(axis, None)
            self.gone.add(axis)
        self.out.begin_curve()

    def set_position(self, words: dict[str, float]) -> None:
        """G92: the tool is where the words say, in coordinates that are shifted for it."""
        if not words:
            return
        scale = self.scale()
        if missing := [k for k in words if k not in self.at and self.out.rows]:
            raise InvalidInput(f"G92: where the tool is in {missing[0]} is not known")
        moved = {k: self.at[k] - scale * v for k, v in words.items() if k in self.at}
        if any(moved.values()):
            self.frames.shift(moved, more=True)
        self.at.update({k: scale * v for k, v in words.items()})
        self.gone -= words.keys()

    # ------------------------------------------------------------ a motion

    def move(self, block: Block, *, cut: bool) -> None:
        """A motion in the mode in force.

        Raises:
            InvalidInput: If it is open where it begins or leads.
        """
        words, modes = block.words, self.modes
        if modes.motion is None:
            raise InvalidInput("no G0, G1, G2 or G3 says how to move there")
        start, tip = dict(self.at), modes.tip or self.frames.plane is not None
        if not tip and not self.axis.machine and self.axis.turned and not set("XYZ") & words.keys():
            self._forget()  # a turn about the pivot of the machine leads the tip elsewhere
        scale = self.scale() if words.keys() & {*"XYZIJKR", "CR"} else 1.0
        self.target(block, scale)
        begin = self.axis.turn(block, relative=modes.relative, cut=cut)
        if not tip and self.axis.turned and self.axis.rotary is not None:
            self.axis.assume_machine()
        unread = not tip and self.axis.turned and not self.axis.machine
        if cut and not unread and len(self.at) < 3:
            self._complete(start, begin, words)
        if modes.motion in (2, 3):
            self._arc(block, start, begin, scale, unread=unread)
            return
        self.axis.read_vector(block)
        if words.keys() & {"R", "CR"}:
            raise InvalidInput("R belongs to an arc (G2, G3), not to a straight motion")
        if unread and self.axis.rotary is not None:
            self._without_tip()
        elif len(self.at) == 3:
            self.straight(start, begin, block, cut=cut)

    def _complete(
        self, start: dict[str, float], begin: dict[str, float], words: dict[str, float]
    ) -> None:
        """A cut before all coordinates are stated: left out, or from 0 where nothing is stated."""
        if self.gone - self.at.keys() and self.modes.motion == 1:
            self.note("cuts are left out while the tool comes from a position of the machine")
            self.out.begin_curve()
        elif set("XYZ") & words.keys():
            for axis in sorted(set("XYZ") - self.at.keys()):
                self.assume_zero(axis)
                start[axis] = 0.0
            if len(start) == 3:
                self._add_point([start[axis] for axis in "XYZ"], begin, cut=False)

    def _forget(self) -> None:
        self.at.clear()
        self.gone.update("XYZ")

    def _without_tip(self) -> None:
        """A motion with turned rotary axes whose X, Y, Z are not those of the tip."""
        self._forget()
        self.out.begin_curve()
        if self.modes.motion != 0:
            self.axis.refuse_without_tip()

    def straight(
        self, start: dict[str, float], begin: dict[str, float], block: Block, *, cut: bool
    ) -> None:
        """Add a straight motion, divided where rotary axes turn the tool on the way."""
        turn = self.axis.largest_turn(begin)
        corner = corner_of(block) or (("R", self.modes.rounding) if self.modes.rounding else None)
        if not (turn and cut) and corner is None and self._corner is None:
            self._add_point([self.at[axis] for axis in "XYZ"], begin, cut=cut)
            return
        end = _point(self.at)
        first = end
        if self._corner is not None:
            before, at, (kind, size) = self._corner
            self._corner = None
            if cut and not turn:
                self._cut_corner(before, at, end, kind, size, begin)
            elif not self.modes.rounding:
                raise InvalidInput("a corner is cut between two straight cuts alone")
        if cut and corner and len(start) == 3:
            if turn:
                raise InvalidInput("a corner of a cut that turns the tool is not read")
            kind, size = corner
            self._corner = _point(start), end, (kind, self.scale() * size)
        count = 1
        # In rapid motion the way of the axis does not matter, and it is one motion.
        if len(start) == 3 and cut and turn:
            if turn > _MOST_TURNED:
                raise InvalidInput(
                    f"a rotary axis turns by {turn:.6g} degrees in one cut, more than "
                    f"{_MOST_TURNED:g}; check the angle"
                )
            first = _point(start)
            step = self.axis.largest_step(first, end, tip=self._of_tip())
            count = max(1, math.ceil(turn / min(_LARGEST_TURN, step) - 1e-9))
        shares = np.arange(1, count + 1) / count
        points = first + shares[:, None] * (end - first)
        points[-1] = end
        self._add(points, shares, begin, cut=cut)

    def _cut_corner(
        self, before: Array, at: Array, end: Array, kind: str, size: float,
        begin: dict[str, float],
    ) -> None:  # fmt: skip
        """Shorten the cut that was added last, and add its corner."""
        first, motion = cut_corner(before, at, end, kind, size)
        last = self.out.rows[-1]
        moved = self.frames.whole.apply(first) if self.frames.changed else first
        self.out.rows[-1] = last._replace(position=tuple(moved.tolist()))
        if isinstance(motion, Arc):
            self._add(*self.out.divide_arc(motion), begin, cut=True)
        elif motion is not None:
            self._add(motion[None], np.ones(1), begin, cut=True)

    def _of_tip(self) -> bool:
        """Whether X, Y, Z are those of the tip."""
        return self.modes.tip or self.frames.plane is not None or not self.axis.machine

    def _add_point(self, point: list[float], begin: dict[str, float], *, cut: bool) -> None:
        """Add the end of a straight motion; in a cut if it differs from the point before."""
        rows = self.out.rows
        direction = self.frames.axis or self.axis.at(begin, 1.0)
        if not self._of_tip():
            point = self.axis.tip(begin, 1.0, point)
        if self.frames.changed:
            point = self.frames.whole.apply(point).tolist()
        if rows and cut:
            length = math.dist(rows[-1].position, point)
            if self.modes.feed == 93:
                self._feed_by_time(length)
            if length < SAME_POINT and rows[-1].direction == direction:
                return
        self.out.add([np.array(point)], [direction], rapid=not cut)

    def _add(
        self, points: Array, shares: Array, begin: dict[str, float], *, cut: bool = True
    ) -> None:
        """Add the points of a motion at some shares of it; in a cut those that differ."""
        rows = self.out.rows
        plane = self.frames.axis
        axes = [plane or self.axis.at(begin, float(share)) for share in shares]
        if not self._of_tip():
            points = np.array([self.axis.tip(begin, float(share), point.tolist())
                               for share, point in zip(shares, points, strict=True)])  # fmt: skip
        if self.frames.changed:
            points = self.frames.whole.apply(points)
        if rows and cut:
            last = rows[-1]
            moved = np.diff(np.vstack([last.position, points]), axis=0)
            lengths = np.sqrt((moved * moved).sum(axis=1))
            before = [last.direction, *axes]
            keep = [k for k in range(len(axes))
                    if lengths[k] >= SAME_POINT or before[k] != axes[k]]  # fmt: skip
            points, axes = points[keep], [axes[k] for k in keep]
            if self.modes.feed == 93:
                self._feed_by_time(float(lengths.sum()))
        self.out.add([*points], axes, rapid=not cut)

    def feed(self, block: Block) -> None:
        """Read F, and S, by which a feed per turn is one per minute."""
        feeds, self._motions_per_minute = self.out.feeds, None
        feeds.turns_per_minute = block.words.get("S", feeds.turns_per_minute)
        feed = block.words.get("F")
        if feed is None or 4 in block.codes:  # the time of a dwell
            return
        if not feed > 0.0:
            raise InvalidInput(f"F: expected a feed above 0, got {feed:g}")
        if self.modes.feed == 93:
            self._motions_per_minute = feed
        else:
            feeds.set(feed * self.out.scale(), per_turn=self.modes.feed == 95)

    def _feed_by_time(self, length: float) -> None:
        """G93: F is how many such motions would take a minute, and belongs to its block alone."""
        if self._motions_per_minute is None:
            raise InvalidInput("G93: each block that cuts needs its own F")
        feed = self._motions_per_minute * length
        # A turn in place has a time, and no feed.
        self.out.feeds.set(feed if feed > 0.0 else math.nan, per_turn=False)

    def _arc(
        self, block: Block, start: dict[str, float], begin: dict[str, float], scale: float,
        *, unread: bool,
    ) -> None:  # fmt: skip
        """Add an arc or a helix: G2 left-handed, G3 right-handed about the axis of the plane."""
        if unread:
            self._without_tip()
            return
        if len(start) < 3 or len(self.at) < 3:
            raise InvalidInput(f"G{self.modes.motion}: where the arc begins is not known")
        if block.words.keys() & set(BY_VECTOR):
            raise InvalidInput("a tool axis by A3, B3, C3 on an arc is not read")
        if block.words.get("P", 1.0) != 1.0:
            raise InvalidInput("P: several turns are not read; write each turn as an arc")
        if self._corner is not None or corner_of(block) is not None or self.modes.rounding:
            raise InvalidInput("a corner is cut between two straight cuts alone")
        s, e = _point(start), _point(self.at)
        centre = centre_of(block, (s, e), scale, self.modes, self.note)
        arc = Arc.between(s, e, centre, axis_of(self.modes))
        self._add(*self.out.divide_arc(arc), begin)


def _point(at: dict[str, float]) -> Array:
    return np.array([at[axis] for axis in "XYZ"])
