"""Straight motions of Klartext: L, LN, RND and CHF, and the holes of its cycles."""

from __future__ import annotations

import math
from collections.abc import Iterable

import numpy as np

from qp_twist.checks import Array
from qp_twist.errors import InvalidInput
from qp_twist.paths.arcs import rounded_corner
from qp_twist.paths.gcode_facts import Facts
from qp_twist.paths.gcode_tool_axis import BY_VECTOR, ToolAxis
from qp_twist.paths.gcode_words import Block as TurnedBlock
from qp_twist.paths.heidenhain_blocks import Words
from qp_twist.paths.heidenhain_cycles import Hole
from qp_twist.paths.heidenhain_frame import Frame
from qp_twist.paths.toolpath_builder import ProgramBuilder

_LARGEST_TURN = 3.0
"""Rotary axes move in proportion; the tool axis is computed at least every this many degrees."""
_MOST_TURNED = 36_000.0
"""Largest turn of a rotary axis in one cut, degrees: beyond it, a number is wrong."""


class StraightMotions:
    """Where the tool of a program is, and how it gets on.

    Attributes:
        out: The points so far.
        axis: The tool axis by rotary axes or vectors.
        frame: Of the coordinates.
        at: Where the tool is in that frame, m, by axis, as far as it is known.
        tip: Whether the coordinates are those of the tip, whatever the rotary axes.
        by_normal: Lines in which the normal is taken as the tool axis.
        corner: RND or CHF before the next motion, and its size, m.
        heading: Direction at the end of the last cut, (3,), if there is one.
    """

    def __init__(self, out: ProgramBuilder, facts: Facts) -> None:
        self.out, self.axis, self.frame = out, ToolAxis(out, facts), Frame()
        self.at: dict[str, float] = {}
        self.tip = False
        self.by_normal: list[int] = []
        self.corner: tuple[str, float] | None = None
        self.heading: Array | None = None
        self._straight = False
        self._refused = False

    def leave(self, axes: Iterable[str]) -> None:
        """Where the tool is along some axes is not known any more."""
        for axis in axes:
            self.at.pop(axis, None)
        self.heading = None
        self.out.begin_curve()

    def approach(self, of: Words, *, away: bool) -> None:
        """APPR and DEP: the way to the contour ends at its first point."""
        if away:
            self.leave("XYZ")
            self._move_to({k: v for k, v in of.values.items() if k in "XYZ"})
            return
        self._move_to(of.values)
        self.heading = None
        self.out.begin_curve()
        if len(self.at) == 3:
            self._add(self._point()[None], {}, [1.0], rapid=False)

    # ------------------------------------------------------------ straight motions

    def line(self, of: Words) -> None:
        """L: a straight motion, over which rotary axes move in proportion."""
        start = self._start()
        moved = self._move_to(of.values)
        begin = self._turn(of)
        if not self.tip and self.axis.rotary is not None and self.axis.turned \
                and not self.frame.tilted:  # fmt: skip
            self._without_tip(rapid=of.rapid)
        elif len(self.at) == 3:
            self._straight_to(start, begin, rapid=of.rapid)
        elif moved and not of.rapid and self.out.rows:
            missing = " and ".join(axis for axis in "XYZ" if axis not in self.at)
            raise InvalidInput(f"L: where the tool is in {missing} is not known")

    def line_by_normal(self, of: Words) -> None:
        """LN: a straight motion with the tool axis TX, TY, TZ, or with M128 along the normal."""
        if self.frame.tilted:
            raise InvalidInput("LN in a tilted plane is not read")
        vectors = {letter: [of.values.get(f"{letter}{axis}", 0.0) for axis in "XYZ"]
                   for letter in "TN"}  # fmt: skip
        if any(vectors["T"]):
            self._take_vector(vectors["T"])
        elif self.tip and any(vectors["N"]):
            self.by_normal.append(self.out.line)
            self._take_vector(vectors["N"])
        self.line(of)

    # ------------------------------------------------------------ holes

    def bore(self, hole: Hole) -> None:
        """The motions of a cycle at the point where the tool is."""
        assert hole.bottom is not None
        scale, feeds, at = self.out.scale(), self.out.feeds, float(self._point()[2])
        near = bottom = above = at
        if hole.near is None or hole.above is None:
            bottom -= scale * hole.bottom
        else:
            near, bottom, above = scale * hole.near, scale * hole.bottom, scale * hole.above
        before = feeds.now()
        if hole.pitch is not None:
            feeds.set(scale * hole.pitch, per_turn=True)
        elif hole.feed is not None:
            self.set_feed(hole.feed)
        for height, rapid in (
            (near, True), (bottom, False), (near, not hole.tapped), (above, True),
        ):  # fmt: skip
            self.at["Z"] = height
            self._straight_to(None, {}, rapid=rapid)
        feeds.set(60.0 * before, per_turn=False)

    def set_feed(self, value: float) -> None:
        """Set a feed in the program's unit: mm, or tenths of an inch, per minute."""
        if value <= 0.0:
            raise InvalidInput(f"F: expected a feed above 0, got {value:g}")
        tenth = 0.1 if self.out.length_unit == "inch" else 1.0
        self.out.feeds.set(tenth * self.out.scale() * value, per_turn=False)

    # ------------------------------------------------------------ shared

    def _start(self) -> Array | None:
        return self._point() if len(self.at) == 3 else None

    def _point(self) -> Array:
        if len(self.at) < 3:
            missing = [axis for axis in "XYZ" if axis not in self.at]
            raise InvalidInput(f"where the tool is in {' and '.join(missing)} is not known")
        return np.array([self.at["X"], self.at["Y"], self.at["Z"]])

    def _move_to(self, values: dict[str, float]) -> bool:
        """Set the coordinates that are stated; whether there are any."""
        named = [name for name in values if name.lstrip("I") in ("X", "Y", "Z")]
        for name in named:
            if name[0] == "I" and name[-1] not in self.at:
                raise InvalidInput(f"{name}: where the tool is in {name[-1]} is not known")
            before = self.at[name[-1]] if name[0] == "I" else 0.0
            self.at[name[-1]] = before + self.out.scale() * values[name]
        others = [name for name in values if name.lstrip("I") in ("U", "V", "W") and values[name]]
        if others:
            raise InvalidInput(f"{others[0]}: a second linear axis is not read")
        return bool(named)

    def _turn(self, of: Words) -> dict[str, float]:
        """Read rotary axes; the angles from which they turn. In a tilted plane they follow it."""
        turned = {name: value for name, value in of.values.items() if name.lstrip("I") in
                  ("A", "B", "C")}  # fmt: skip
        if self.frame.tilted and self.tip and any(turned.values()):
            raise InvalidInput(
                "rotary axes with M128 in a tilted plane lean the tool out of it, which is not read"
            )
        if self.frame.tilted:
            for name in turned:
                self.out.pass_over(f"{name} in a tilted plane")
            turned = {}
        for name in [name for name in turned if name[0] == "I"]:
            turned[name[1]] = turned.pop(name) + self.axis.angles.get(name[1], 0.0)
        if of.rapid:  # from where they turn does not matter
            self.axis.angles = turned | self.axis.angles
        return self.axis.turn(TurnedBlock(words=turned), relative=False, cut=not of.rapid)

    def _take_vector(self, vector: list[float]) -> None:
        self.axis.read_vector(TurnedBlock(words=dict(zip(BY_VECTOR, vector, strict=True))))

    def _without_tip(self, *, rapid: bool) -> None:
        """A motion with turned rotary axes whose coordinates are not those of the tip."""
        self.leave("XYZ")
        if not rapid and not self._refused:
            self._refused = True
            self.out.problem(
                "the rotary axes are turned without M128, FUNCTION TCPM or PLANE SPATIAL before, "
                "so X, Y, Z depend on the dimensions of the machine; have the CAM system write one "
                "of these"
            )

    def _straight_to(self, start: Array | None, begin: dict[str, float], *, rapid: bool) -> None:
        """Add a straight motion to where the tool is now."""
        end, turn = self._point(), self.axis.largest_turn(begin)
        if turn > _MOST_TURNED:
            raise InvalidInput(f"a rotary axis turns by {turn:.6g} degrees in one motion")
        count = 1 if start is None or rapid else max(1, math.ceil(turn / _LARGEST_TURN - 1e-9))
        origin = end if start is None else start
        self._finish_corner(start, end, rapid=rapid)
        shares = np.arange(1, count + 1) / count
        points = origin + shares[:, None] * (end - origin) if count > 1 else end[None]
        self._add(points, begin, shares.tolist(), rapid=rapid)
        way = end - origin
        length = math.hypot(*way)
        if rapid:
            self.heading = None
        elif length > 1e-9:
            self.heading = way / length
        self._straight = not rapid and length > 1e-9

    def _finish_corner(self, start: Array | None, end: Array, *, rapid: bool) -> None:
        """Round the corner, or cut it, between the last straight cut and the one to a point."""
        corner, self.corner = self.corner, None
        if corner is None:
            return
        kind, size = corner
        rows = self.out.rows
        if start is None or rapid or not self._straight or len(rows) < 2:
            raise InvalidInput(f"{kind} is read between two straight cuts alone")
        before = self.frame.unplaced(np.array(rows[-2].position), self.out.scale())
        # A chamfer of the length l begins and ends where an arc of the radius l / tan(φ/2) does.
        if kind == "CHF":
            first, second = start - before, end - start
            turn = math.atan2(float(np.linalg.norm(np.cross(first, second))), float(first @ second))
            size /= max(math.tan(0.5 * turn), 1e-12)
        arc = rounded_corner(before, start, end, size)
        if abs(arc.axis[2]) < 0.99:
            raise InvalidInput(f"{kind} is read in the plane of X and Y alone")
        rows[-1] = rows[-1]._replace(
            position=tuple(self.frame.placed(arc.start[None], self.out.scale())[0].tolist())
        )
        points = self.out.divide_arc(arc)[0] if kind == "RND" else arc.end[None]
        self._add(points, {}, [1.0] * len(points), rapid=False)

    def _add(
        self, points: Array, begin: dict[str, float], shares: list[float], *, rapid: bool
    ) -> None:
        """Add points of a motion, in the program's frame, at shares of it."""
        axes = [self.axis.at(begin, share) for share in shares]
        if self.frame.moved:
            axes = (np.array(axes) @ self.frame.rotation.T).tolist()
            points = self.frame.placed(points, self.out.scale())
        self.out.add([*points], axes, rapid=rapid)
