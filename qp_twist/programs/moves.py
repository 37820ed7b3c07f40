"""What a program does while it is executed, and its joint moves, for which ``check`` vouches."""

from __future__ import annotations

import math
import re
from collections.abc import Collection, Iterable, Mapping, Sequence
from types import MappingProxyType
from typing import Literal, NamedTuple, TypeVar

import mink
import numpy as np

from qp_twist.errors import InvalidInput
from qp_twist.files import of_lines
from qp_twist.programs.joint_moves import (
    AXES,
    Circle,
    ExternalColumn,
    JointMoves,
    Speed,
    Target,
    Turning,
    Zone,
)

_TURNS = {
    "space": "likewise", "path": "so as seen from the tangent", "tangent": "as the tangent alone",
}  # fmt: skip
_LISTED = 12
"""Kinds of statements that a note lists."""
Kind = Literal["passed", "setting", "speed", "pause"]
"""Statements that do not move the robot: others, of tool, base or load, of speeds, waits."""


_Value = TypeVar("_Value")


class JointMove(NamedTuple):
    """A joint move, in ``seconds``, to angles or a pose, or to what the program does not state.

    With rates, in unit/s, there and where it begins, each joint moves on a cubic. External axes are
    given by name, each with its unit, if the program says it; others stay. With ``tool``, the name
    of one, that moves straight. ``target`` states where to for ``check``, ``speed`` how fast a
    straight move, or a joint move from rest to rest, is that has no time, ``acceleration`` of its
    ramps, m/s², or of the joint that goes farthest, rad/s², if it is stated, ``part`` what moves
    the part on which the tool moves straight to angles, ``circle`` that it is on one, ``tcp`` the
    pose of that tool in the flange, if the program states it, ``passes`` that the robot does not
    come to rest at its end, which is not rounded either.
    """

    line: int
    angles: list[float] | None = None
    pose: mink.SE3 | None = None
    seconds: float | None = None
    rates: list[float] | None = None
    external: Mapping[str, tuple[float, str]] = MappingProxyType({})
    tool: str = ""
    target: Target | None = None
    speed: Speed | None = None
    part: str | None = ""
    circle: Circle | None = None
    acceleration: float | None = None
    tcp: mink.SE3 | None = None
    passes: bool = False


class Moves:
    """Takes what a program does, in its order; what is no concern of it does nothing.

    Attributes:
        strict: Whether what is not known is refused, instead of taken to move nothing.
        frame: Name of the frame in force, and its pose in the robot's base if the file states it.
        feed: Along the path, m/s.
    """

    strict = False

    def __init__(self) -> None:
        self.frame: tuple[str, mink.SE3 | None] = "", None
        self.feed = math.nan

    def joint(self, move: JointMove) -> None:
        """A joint move."""

    def line(self, line: int, pose: mink.SE3) -> None:
        """A straight move at the feed in force."""

    def arc(
        self, line: int, via: mink.SE3, pose: mink.SE3, sweep_deg: float | None = None,
        rule: Turning = "space",
    ) -> None:  # fmt: skip
        """A move along the circle through a point, to its end or, with an angle, as far as that."""

    def external(self, line: int, axes: Mapping[str, tuple[float, str]]) -> None:
        """The external axes of a Cartesian target, each with its unit, if the program says it."""

    def wait(self, line: int, word: str, seconds: float) -> None:
        """A wait of known length."""
        self.noted(line, word, "passed")

    def rounds(self, zone: Zone) -> None:
        """The next point is rounded."""
        self.noted(zone.line, zone.mark, "passed")

    def rests(self) -> None:
        """The robot comes to rest where the last move, which is streamed, leads."""

    def uses(self, tool: str, frame: str) -> None:
        """Names or numbers of the tool and the frame of a move of the tool."""

    def noted(self, line: int, word: str, kind: Kind) -> None:
        """A statement that does not move the robot."""

    def called(self, line: int, name: str) -> bool:
        """Whether a procedure that the file does not have is one of the process."""
        return False

    def note(self, text: str) -> None:
        """What was taken for granted, once."""


class _Point(NamedTuple):
    """A point to which a program moves.

    Attributes:
        angles: What the controller shows there; NaN where only its pose is known.
        move: The move to it.
        zone: How it is rounded, if it is.
        external: Positions of the external axes, by name.
    """

    angles: list[float]
    move: JointMove
    zone: Zone | None
    external: Mapping[str, float]


class Course(Moves):
    """Points and times of a program's joint moves.

    A move without a time, such as one at a share of the largest speed, leaves the whole program
    without times: how long it takes depends on the controller.
    """

    strict = True

    def __init__(self, calls: Collection[str] = ()) -> None:
        """``calls``: procedures that switch the process, and which the program may lack."""
        super().__init__()
        self._calls = {name.lower() for name in calls}
        self._points: list[_Point] = []
        self._untimed: tuple[int, str, str] | None = None
        self._waits: list[tuple[int, str]] = []
        self._notes: dict[str, None] = {}
        self._noted: dict[Kind | Literal["called"], dict[str, dict[int, None]]] = {
            "called": {}, "setting": {}, "passed": {},
        }  # fmt: skip
        self._external: dict[str, float] = {}
        self._columns: dict[str, ExternalColumn] = {}
        self._tool = ""
        self._zone: Zone | None = None
        self._rests: set[int] = set()
        self._numbers: dict[str, dict[str, None]] = {"tool": {}, "frame": {}}

    def joint(self, move: JointMove) -> None:
        """Move to angles; the first move leads to the start, and its time does not count."""
        line, angles, _, seconds, rates, external, tool, target, speed, _, circle, a, *_ = move
        if angles is None and target is None:
            raise InvalidInput("a Cartesian target; only joint angles can be checked.", line=line)
        angles = [math.nan] * AXES if angles is None else angles
        via = [circle.angles] if circle and circle.angles is not None else []
        for values in (*(() if target else (angles, rates or angles)), *via):
            if len(values) != AXES or not all(map(math.isfinite, values)):
                stated = ", ".join(f"{value:g}" for value in values)
                raise InvalidInput(f"expected {AXES} finite angles, got {stated}.", line=line)
        if seconds is not None and not 0.0 < seconds < math.inf:
            raise InvalidInput(
                f"the move takes {seconds:g} s; a time is positive and finite.", line=line
            )
        if not all(0.0 < each < math.inf for each in (*(speed or ()), 1.0 if a is None else a)):
            raise InvalidInput("a speed or acceleration is not positive and finite.", line=line)
        if self._points and seconds is None and speed is None:
            self._without_time(line, "the move", "has no time")
        if tool and not self._points:
            raise InvalidInput("expected a joint move first, to where it begins.", line=line)
        if tool and self._tool not in ("", tool):
            raise InvalidInput(f"moves the tool {tool} straight, before {self._tool}.", line=line)
        self._tool = tool or self._tool
        zone, self._zone = self._zone, None
        if not move.passes and (zone is None or min(zone.radius, zone.share) == 0.0):
            self._rests.add(len(self._points))
        self.external(line, external)
        self._points.append(_Point(angles, move, zone, dict(self._external)))

    def external(self, line: int, axes: Mapping[str, tuple[float, str]]) -> None:
        """One that is not given stays where it is.

        It moves if it is not where the first move has it, or 0, which is what controllers without
        the axis write.
        """
        for axis, (value, unit) in axes.items():
            if not math.isfinite(value):
                raise InvalidInput(f"{axis}: expected a number, got {value}.", line=line)
            before = self._external.get(axis, 0.0 if self._points else value)
            column = self._columns.setdefault(axis, ExternalColumn(axis, unit))
            if column.unit != unit:
                raise InvalidInput(f"{axis} is in {column.unit} before, here in {unit}.", line=line)
            if value != before and column.moved is None:
                what = f"it moves the external axis {axis} to {value:g}, from {before:g}"
                self._columns[axis] = column._replace(moved=(line, what))
            self._external[axis] = value

    def wait(self, line: int, word: str, seconds: float) -> None:
        """Stay at the last point."""
        if not 0.0 <= seconds < math.inf:
            raise InvalidInput(f"a wait of {seconds:g} s; expected a finite time.", line=line)
        if self._points:  # whose zone no controller rounds
            self.rests()
        if self._points and seconds > 0.0:
            last = self._points[-1]
            self.joint(JointMove(line, last.angles, None, seconds, target=last.move.target))
            self._waits.append((line, f"a wait of {seconds:g} s"))

    def rounds(self, zone: Zone) -> None:
        """The point of the next move."""
        if min(zone.radius, zone.radius if zone.turning is None else zone.turning) < 0.0:
            raise InvalidInput(
                f"{zone.mark}: a point is rounded by a negative distance; give 0 or more.",
                line=zone.line,
            )
        self._zone = zone

    def rests(self) -> None:
        """At the last point."""
        self._rests.add(len(self._points) - 1)

    def uses(self, tool: str, frame: str) -> None:
        """Their numbers, which the header may state."""
        for what, name in (("tool", tool), ("frame", frame)):
            number = [] if "{" in name else re.findall(r"\d+(?=\D*$)", name)  # else its values
            self._numbers[what].update(dict.fromkeys(number))

    def noted(self, line: int, word: str, kind: Kind) -> None:
        """Speeds and waits of unknown length leave the program without times."""
        if kind == "pause":
            if self._points:
                self._without_time(line, word, "waits for something")
            return
        if kind == "speed":
            self._without_time(line, word, "changes speeds or accelerations")
        self._noted["passed" if kind == "passed" else "setting"].setdefault(word, {})[line] = None

    def called(self, line: int, name: str) -> bool:
        """A procedure that the task names is passed over, and noted."""
        if name.lower() not in self._calls:
            return False
        self._noted["called"].setdefault(name, {})[line] = None
        return True

    def note(self, text: str) -> None:
        """Add a note; the same one once."""
        self._notes[text] = None

    def _without_time(self, line: int, what: str, why: str) -> None:
        self._untimed = self._untimed or (line, what, why)

    def moves(self, header: Mapping[str, str]) -> JointMoves:
        """The moves of the program.

        Raises:
            InvalidInput: If there are fewer than two points.
        """
        if len(self._points) < 2:
            raise InvalidInput(
                f"there {'is one joint move' if self._points else 'are no joint moves'} in the "
                "program; expected two or more."
            )
        moves = [point.move for point in self._points]
        straight = [move.line if move.tool else 0 for move in moves[1:]]
        speeds = [move.speed if move.seconds is None else None for move in moves[1:]]
        for k, (speed, line) in enumerate(zip(speeds, straight, strict=True)):
            if speed is not None and not line and not {k, k + 1} <= self._rests:
                self._without_time(moves[k + 1].line, "the move", "does not begin and end at rest")
        parts: dict[str | None, int] = {}
        for move in moves:
            if move.tool or move.target is not None:
                part = move.target.frame.part if move.target else move.part
                parts.setdefault(part, move.line)
        notes = list(self._notes)
        if self._tool:
            notes.append(_of_straight([move for move in moves[1:] if move.tool], "hand" in parts))
        targets = [move.target for move in moves if move.target is not None]
        frames = {target.frame.name: target.frame.pose for target in targets}
        if unknown := [name for name, pose in frames.items() if pose is None]:
            notes.append(
                f"positions are in {', '.join(unknown)}, which the program does not state: it has "
                "to be the world of the task, or the part's frame if that moves"
            )
        if called := self._noted["called"]:
            notes.append(
                f"procedures of the process, which are not in the file: {_listed(called)}; "
                "they must not move the robot, and the time that they take is not known"
            )
        untimed = None
        if self._untimed is not None:
            line, what, why = self._untimed
            untimed = line, f"{what} {why}"
            notes.append(
                f"{what} of line {line} {why}, so that how long the program takes depends on the "
                "controller"
            )
        unchanged = (
            "no path depends on the load; tool and frame count as said" if targets or self._tool
            else "the path of axis moves does not depend on tool, base, load or speed (checked is "
                 "the task's tool)"
        )  # fmt: skip
        for words, why in (
            (self._noted["setting"], unchanged),
            (self._noted["passed"], "it does not move the robot"),
        ):
            if words:
                notes.append(f"passed over, since {why}: {_listed(words)}")
        times = [math.nan if move.seconds is None else move.seconds for move in moves[1:]]
        rates = [move.rates for move in moves if move.rates is not None]
        return JointMoves(
            np.array([
                point.angles + [point.external.get(axis, math.nan) for axis in self._columns]
                for point in self._points
            ]),
            np.array(times) if untimed is None else None,
            np.array(rates) if rates else None,
            header, tuple(notes), tuple(self._waits), untimed, tuple(self._columns.values()),
            tuple(straight) if self._tool else None,
            targets=_if_any(move.target for move in moves), speeds=_if_any(speeds), parts=parts,
            circles=_if_any(move.circle for move in moves[1:]),
            zones=_if_any(point.zone for point in self._points),
            accelerations=_if_any(move.acceleration for move in moves),
            numbers={what: ", ".join(each) for what, each in self._numbers.items()},
            tcps=_if_any(move.tcp for move in moves), rests=tuple(sorted(self._rests)),
            lines=tuple(move.line for move in moves),
        )  # fmt: skip


def _of_straight(moves: Sequence[JointMove], by_hand: bool) -> str:
    """A note on the straight moves of a tool, or of the part that the robot holds along it."""
    if by_hand:
        return (
            f"{len(moves)} straight moves of the part along a tool at rest, which has to be the "
            "task's frame; the part turns in proportion about a fixed axis"
        )
    stated = all(move.tcp is not None for move in moves)
    where = "is where the program states it" if stated else "has to be the task's frame"
    circles = [move.circle.rule for move in moves if move.circle is not None]
    turns = [f"{_TURNS[rule]} ({circles.count(rule)})" for rule in sorted({*circles})]
    return (
        f"{len(moves) - len(circles)} straight moves of {moves[0].tool}"
        f"{f' and {len(circles)} on circles' if circles else ''}: its TCP {where}; "
        "its orientation turns in proportion about a fixed axis"
        + (f", and on circles {', '.join(turns)}" if turns else "")
    )


def _if_any(values: Iterable[_Value | None]) -> tuple[_Value | None, ...]:
    """Values of all points or moves, if any has one."""
    found = tuple(values)
    return found if any(each is not None for each in found) else ()


def _listed(words: Mapping[str, Mapping[int, None]]) -> str:
    """Words with the lines where they stand."""
    found = [f"{word} ({of_lines([*lines])})" for word, lines in words.items()]
    if len(found) > _LISTED:
        found[_LISTED:] = [f"and {len(found) - _LISTED} more kinds"]
    return ", ".join(found)
