"""Joint moves of a robot program, in the controller's axes and units."""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from types import MappingProxyType
from typing import Any, Literal, NamedTuple

import mink
import numpy as np

from qp_twist.checks import Array, Mask
from qp_twist.errors import InvalidInput

AXES = 6
"""Number of axes of the robots: all arms of their controllers have six."""

PACE = 0.02
"""Share by which speeds of moves may differ and be one, or be below the planned one; also largest
difference between the shares of time and of way on a move that is at one speed."""
RESTS = 1e-6
"""On a way up to this, m, the tool only turns; or it rests if it turns less, too, rad."""
_CLOCK = 1e-12
"""Rounding of times that are added and subtracted, s."""


class ExternalColumn(NamedTuple):
    """The values of an external axis.

    Attributes:
        name: The axis.
        unit: Of its values, mm or deg; empty if the program does not say it.
        moved: The line of the first move that moves it, and a sentence; ``None``: it stands still.
    """

    name: str
    unit: str = ""
    moved: tuple[int, str] | None = None


class ProgramFrame(NamedTuple):
    """A tool in the flange, or a frame of points in the robot's base.

    Attributes:
        name: As the program calls it.
        pose: Its pose; ``None`` if the program does not state it.
        part: What moves a frame, ``"positioner"`` or ``"hand"`` (the robot), empty: nothing;
            ``None`` if the program does not state it.
    """

    name: str
    pose: mink.SE3 | None = None
    part: str | None = ""


class Target(NamedTuple):
    """A point as the pose of a tool.

    Attributes:
        pose: The tool in the frame.
        tool: The tool.
        frame: The frame.
        configuration: The numbers by which the language tells the joints at a pose, cf1, cf4, cf6
            and cfx or S and T (:mod:`~qp_twist.robots.configurations`); empty without.
        line: Of the program that states it.
    """

    pose: mink.SE3
    tool: ProgramFrame
    frame: ProgramFrame
    configuration: tuple[int, ...] = ()
    line: int = 0


Turning = Literal["space", "path", "tangent"]
"""How a tool turns on a circle: in proportion, as on a straight line, in space or as seen from the
circle's tangent; or as the tangent alone does."""


class Circle(NamedTuple):
    """The circle of a move: through the point before, a point between and its end.

    Attributes:
        rule: How the tool turns.
        angles: What the controller shows at the point between, if it is stated so.
        target: Else its pose.
        sweep: How far the tool goes instead of to the end, rad, below 0 the other way round.
        turned: Whether the tool has to be turned at the point between as the rule has it there.
    """

    rule: Turning
    angles: list[float] | None = None
    target: Target | None = None
    sweep: float | None = None
    turned: bool = False


class Speed(NamedTuple):
    """Of a straight move: that of the tool's point, m/s, and of its turn, rad/s.

    The move takes as long as the slower of both needs. Where languages do not state how fast the
    tool turns, that counts as if it took no time. Of a joint move ``linear`` is that of the joint
    that goes farthest, rad/s; the move is from rest to rest.
    """

    linear: float
    angular: float = 1e3

    def seconds(self, way: float, turn: float) -> float:
        """Time of a move, s, whose point goes ``way`` m and whose tool turns by ``turn`` rad."""
        return max(way / self.linear, turn / self.angular)


class Zone(NamedTuple):
    """Where a robot may leave its moves on both sides of a point, which it rounds.

    No controller begins before the middle of the shorter move, but URScript, which leaves out a
    point whose blend overlaps the next one.

    Attributes:
        line: Of the program.
        mark: As the program states it.
        radius: Distance from the point, m; ∞: half of the shorter move.
        turning: Likewise from where on the tool turns otherwise, m; ``None``: from the same.
        share: Of half of the shorter move, in place of a distance.
        overlaps: Whether blends may overlap.
    """

    line: int
    mark: str
    radius: float = math.inf
    turning: float | None = None
    share: float = 1.0
    overlaps: bool = False


class Around(NamedTuple):
    """What stands behind a point of a program: a comment, or the name of a procedure to call."""

    text: str
    call: bool = False


@dataclass(frozen=True, eq=False)
class JointMoves:
    """Moves from point to point, straight in the axes, or of the tool.

    Attributes:
        angles: What the controller shows at each point, in the dialect's unit, (N, 6 + k); nan for
            an external axis that the program did not state by then, and for the axes of a point
            that is a pose.
        durations: Time of each move, s, (N − 1,), nan where that depends on the way (``speeds``);
            ``None`` if the program has none, or not for every move.
        velocities: Rates of ``angles`` at the points, if axes move on cubics, unit/s, (N, 6 + k).
        header: What the program says about itself; empty without a header of this package.
        notes: What else the program has, and what is not looked at.
        waits: Waits of known length, each with its line.
        untimed: The line because of which nothing says how long the program takes, and why;
            ``None`` if it has times.
        external: The last k columns.
        straight: Of each move the line of a program in which the tool moves straight, and 0 of
            joint moves, (N − 1,); ``None`` without straight moves.
        halves: Half of the shorter of the moves beside each point, m, the most that controllers
            round, (N,); ``None`` where the way of the tool is not known.
        shares: Of ``halves`` what the robot may round, (N,); 0: it stops there; ``None``: it
            stops at both ends.
        tool: Number of the tool of straight moves to joint angles.
        targets: The points that are poses, (N,), else ``None``; empty without.
        speeds: Those of the moves that state a speed, (N − 1,), else ``None``; empty without. Joint
            moves with a speed are from rest to rest.
        around: What stands behind points, by their index from 0.
        constant: Whether moves are of those from one stop to the next at constant speed, or with
            circles at speeds that the arcs of corners allow, (N − 1,); empty without.
        tcp: The task's frame in the flange of a known robot.
        part: What moves the part on which the tool of a written program moves straight, empty:
            nothing.
        frame: Number of the frame that is on such a part.
        parts: Likewise of a program that is read, each with the line of the first such move.
        circles: Those of moves of ``straight`` on a circle, (N − 1,), else ``None``; empty without.
        zones: Of a program that is read, how points are rounded, (N,), else ``None``; empty
            without.
        accelerations: Of the ramps of the moves to the points, m/s² of the tool, or rad/s² of the
            joint that goes farthest, (N,), else ``None``; empty without.
        numbers: Of a program that is read, the numbers of ``tool`` and ``frame`` that it uses.
        tcps: Likewise, where it states the tool of a straight move by its pose in the flange, that
            pose, (N,), else ``None``; empty without.
        rests: Likewise, the points at which the robot comes to rest.
        lines: Likewise, the lines of the moves to the points, (N,).
    """

    angles: Array
    durations: Array | None
    velocities: Array | None = None
    header: Mapping[str, str] = field(default_factory=dict)
    notes: tuple[str, ...] = ()
    waits: tuple[tuple[int, str], ...] = ()
    untimed: tuple[int, str] | None = None
    external: tuple[ExternalColumn, ...] = ()
    straight: tuple[int, ...] | None = None
    halves: Array | None = None
    shares: Array | None = None
    tool: int = 1
    targets: tuple[Target | None, ...] = ()
    speeds: tuple[Speed | None, ...] = ()
    around: Mapping[int, tuple[Around, ...]] = field(default_factory=dict)
    constant: tuple[bool, ...] = ()
    tcp: mink.SE3 | None = None
    part: str = ""
    frame: int = 1
    parts: Mapping[str | None, int] = field(default_factory=dict)
    circles: tuple[Circle | None, ...] = ()
    zones: tuple[Zone | None, ...] = ()
    accelerations: tuple[float | None, ...] = ()
    numbers: Mapping[str, str] = field(default_factory=dict)
    tcps: tuple[mink.SE3 | None, ...] = ()
    rests: tuple[int, ...] = ()
    lines: tuple[int, ...] = ()

    @property
    def stops(self) -> Mask:
        """Points at which the robot stops, (N,)."""
        if self.shares is None:
            return np.isin(np.arange(len(self.angles)), [0, len(self.angles) - 1])
        stops: Mask = self.shares == 0.0
        return stops

    @property
    def in_times(self) -> Mask:
        """Which moves are in a time that the program states, (N − 1,)."""
        return np.array(
            [speed is None for speed in self.speeds or (None,) * (len(self.angles) - 1)]
        )

    @property
    def points(self) -> int:
        """Number of points, those between on circles, too."""
        return len(self.angles) + len(list(filter(None, self.circles)))

    def lines_behind(self, point: int, comment: str, call: str) -> list[str]:
        """The lines behind a point, in the patterns of a language, with ``{}`` for the text."""
        return [
            (call if each.call else comment).format(each.text)
            for each in self.around.get(point, ())
        ]

    def __repr__(self) -> str:
        time = "" if self.durations is None else f", {float(self.durations.sum()):.6g} s"
        return f"JointMoves({len(self.angles)} points{time})"


Beside = Callable[[str], bytes | None]
"""The content of a file in the program's folder by its name, capitals ignored; ``None`` without."""


class Dialect(NamedTuple):
    """A language of robot programs.

    Attributes:
        name: As in ``--to``.
        title: As in messages.
        suffix: Suffix of its files.
        unit: ``"rad"`` or ``"deg"``.
        decimals: Decimals of angles and rates.
        time_decimals: Decimals of times, s.
        axis_names: Names of the axes.
        cubic: Whether its programs move axes on cubics through points with velocities.
        longest: Characters of a program's name.
        name_is: What that name is.
        encode: (program name, moves, header lines) to the texts of files by name.
        execute: (what takes the moves, lines, name of the file, files beside it) to the comments.
        stopped: (text, line that is no statement) to a text at which a controller stops.
        external: Names of external axes.
        of_parts: What the names of those begin with that carry the part; empty: no matter.
        to_fill_in: Statements with gaps, by which a person sets what no program states.
        frames_to_fill_in: Likewise tool and base, of programs without moves of the tool, which
            state them.
        states_frames: Whether programs can state the values of tool and base.
        period: Shortest time in which its controllers interpolate, s: no move is shorter; 0 where
            the program itself divides time.
        zone: How far from a point the robot begins to round it, m, if that is always the same.
        points: What straight moves of the tool lead to, if they are written: ``"joints"``,
            ``"poses"``, the default first.
        speeds: Units in which speeds of straight moves are whole numbers, m/s, of which the first
            that is fine enough counts; where none is, the time is written. Empty: no matter.
        constant: Largest acceleration of moves at constant speed of the tool, from stop to stop,
            m/s²; 0 if it has none.
        numbered: Whether tools have numbers.
        parts: Of straight moves on a part that moves (``"positioner joints"``, ``"positioner
            poses"``, ``"hand joints"``), if they are written: what a person has to compare.
        circles: How the tool may be made to turn on circles, if they are written.
        rounding: Of shares of half moves from which on points are rounded, and of these halves, m,
            the shares that are printed.
        tool_text: The pose of a tool in the flange, as headers state it.
        two_angles: Whether its controllers may swing an axis of the tool and turn about it, instead
            of turning about one axis.
    """

    name: str
    title: str
    suffix: str
    unit: str
    decimals: int
    time_decimals: int
    axis_names: tuple[str, ...]
    cubic: bool
    longest: int
    name_is: str
    encode: Callable[[str, JointMoves, tuple[str, ...]], dict[str, str]]
    execute: Callable[[Any, Sequence[str], str, Beside], list[str]]
    stopped: Callable[[str, str], str] = lambda text, line: f"{line}\n{text}"
    external: tuple[str, ...] = ()
    of_parts: str = ""
    period: float = 0.0
    to_fill_in: tuple[str, ...] = ()
    frames_to_fill_in: tuple[str, ...] = ()
    states_frames: bool = True
    zone: float = math.inf
    points: tuple[Literal["joints", "poses"], ...] = ()
    speeds: tuple[float, ...] = ()
    constant: float = 0.0
    numbered: bool = True
    two_angles: bool = False
    parts: Mapping[str, str] = MappingProxyType({})
    circles: tuple[Turning, ...] = ()
    rounding: Callable[[Array, Array], Array] = lambda shares, _: shares
    tool_text: Callable[[mink.SE3], str] = str

    def external_names(self, axes: Sequence[tuple[str, bool]]) -> tuple[str, ...]:
        """The names of external axes: of each its name, or empty, and whether it carries the part.

        Raises:
            InvalidInput: If the language does not have them.
        """
        left, found = [*self.external], []
        for name, on_part in axes:
            fits = [
                each for each in left
                if (each.lower() == name.lower() if name else
                    not self.of_parts or each.startswith(self.of_parts) == on_part)
            ]  # fmt: skip
            if not fits:
                have = ", ".join(self.external) or "none"
                raise InvalidInput(
                    f"{self.title} has no external axis {name or f'for {len(axes)} joints'}, or it "
                    f"is stated twice; its external axes are {have}."
                )
            left.remove(fits[0])
            found.append(fits[0])
        return tuple(found)

    def check_name(self, name: str) -> None:
        """Refuse a program name that the controller does not take.

        Raises:
            InvalidInput: If it is not a letter, then letters, digits and _.
        """
        if not re.fullmatch(r"[A-Za-z][A-Za-z0-9_]*", name) or len(name) > self.longest:
            raise InvalidInput(
                f"the file's name is the program's, and {self.title} takes a letter, then letters, "
                f"digits and _, at most {self.longest} characters ({self.name_is}); got {name!r}."
            )


def printed(moves: JointMoves, dialect: Dialect) -> JointMoves:
    """The moves with the digits that the dialect prints.

    Times are rounded up. Rounded angles make a joint travel a digit more or less, and no time makes
    up for that: where times are whole milliseconds, one more would jerk all joints.

    Raises:
        InvalidInput: If there are no times, or one is not positive.
    """
    if moves.durations is None:
        raise InvalidInput(
            "the trajectory has no times, so that a program would not know how fast to move; give "
            "its task a [feed], or write times into the file."
        )
    if not (moves.durations > 0.0).all():
        k = int(np.argmin(moves.durations > 0.0))
        raise InvalidInput(
            f"times: row {k + 2} is not later than row {k + 1}; a move needs a positive time."
        )
    angles = np.round(moves.angles, dialect.decimals) + 0.0  # no -0
    if moves.velocities is not None and dialect.cubic:
        durations = np.round(moves.durations, dialect.time_decimals)
        velocities = np.round(moves.velocities, dialect.decimals) + 0.0
        least = 10.0**-dialect.time_decimals
        durations = np.maximum(durations, least)
        return replace(moves, angles=angles, durations=durations, velocities=velocities)
    second = 10.0**dialect.time_decimals
    ticks = np.ceil((moves.durations - _CLOCK) * second)
    return replace(moves, angles=angles, durations=ticks / second, velocities=None)
