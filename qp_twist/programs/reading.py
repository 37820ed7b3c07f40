"""Parts that the readers share: numbers, statements, calls, and the course of a program.

A reader knows a small grammar of its language: moves, calls, waits, speeds, and statements that
neither move the robot nor change where a move leads. What is not in the grammar is refused.
"""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Collection, Iterable, Mapping, Sequence
from typing import NamedTuple

import numpy as np

from qp_twist.checks import Array
from qp_twist.errors import InvalidInput
from qp_twist.programs.joint_moves import AXES, JointMoves

NUMBER = r"[-+]?(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?"
LONGEST = 80
"""Characters of a statement that messages show."""
DOES_NOT_PASS = "DOES NOT PASS ITS CHECK"
"""How a program begins that is written although its motion does not pass: no statement of any of
the languages, so that a controller stops at it."""
_MOST_STATEMENTS = 200_000
"""Statements that a program may execute, those of called procedures at every call."""
_LISTED = 12
"""Kinds of statements that a note lists."""
_DEEPEST = 30
"""Calls inside each other."""


def shown(text: str) -> str:
    """A statement as messages show it."""
    text = " ".join(text.split())
    return repr(text if len(text) <= LONGEST else text[: LONGEST - 1] + "…")


def refuse(line: int, text: str, why: str) -> InvalidInput:
    """The error for a statement."""
    return InvalidInput(f"{shown(text)}: {why}", line=line)


def number_of(line: int, text: str, name: str = "a number") -> float:
    """A finite number, as programs write them."""
    if not re.fullmatch(NUMBER, text.strip(), re.ASCII) or not math.isfinite(float(text)):
        raise refuse(line, text, f"expected {name}.")
    return float(text)


def six(line: int, texts: Sequence[str]) -> list[float]:
    """Six numbers."""
    if len(texts) != AXES:
        raise refuse(line, ", ".join(texts), f"expected {AXES} angles, got {len(texts)}.")
    return [number_of(line, text, "an angle") for text in texts]


def split(text: str) -> list[str]:
    """Arguments at commas outside brackets; one empty text for nothing."""
    parts, depth, start = [], 0, 0
    for place, mark in enumerate(text):
        depth += (mark in "[({") - (mark in "])}")
        if mark == "," and depth == 0:
            parts.append(text[start:place].strip())
            start = place + 1
    return [*parts, text[start:].strip()]


def check_no_call(line: int, statement: str, text: str, reads: str) -> None:
    """Refuse an expression that calls a function, which might move the robot.

    Args:
        line: Its number.
        statement: The whole statement.
        text: The expression.
        reads: What is read, for the message.
    """
    if re.search(r"[\w\])}]\s*\(", text, re.ASCII) or ":=" in text:
        raise refuse(
            line, statement, f"a call in an expression is not read; only {reads} can be checked."
        )


def without_texts(line: int, text: str, quotes: str, comment: str) -> tuple[str, str]:
    """A line's code with empty texts in place of its quoted ones, and its comment.

    Args:
        line: Its number.
        text: The line.
        quotes: Characters that begin and end a text; doubled, they stand in it.
        comment: The character that begins a comment.

    Raises:
        InvalidInput: If a text has no end, or what is no comment has other characters than ASCII.
    """
    code, place = "", 0
    while place < len(text):
        mark = text[place]
        if mark == comment:
            break
        if mark in quotes:
            quoted = re.compile(f"{mark}(?:[^{mark}]|{mark}{mark})*{mark}").match(text, place)
            if quoted is None or "\\" in quoted[0]:
                raise refuse(line, text, "expected a text that ends on its line, without \\ in it.")
            code, place = code + '""', quoted.end()
        else:
            code, place = code + mark, place + 1
    if not code.isascii():
        raise refuse(line, code, "expected ASCII characters outside comments and texts.")
    return code.strip(), text[place + 1 :]


class Course:
    """Points and times of a program while it is executed.

    A move without a time, such as one at a share of the largest speed, leaves the whole program
    without times: how long it takes depends on the controller.
    """

    def __init__(self) -> None:
        self.points: list[list[float]] = []
        self.durations: list[float] = []
        self.velocities: list[list[float]] = []
        self._untimed: tuple[int, str, str] | None = None
        self._waits: list[str] = []
        self._notes: dict[str, None] = {}
        self._passed: dict[str, dict[int, None]] = {}
        self._settings: dict[str, dict[int, None]] = {}
        self._external: dict[str, float] | None = None
        self._rounded = False
        self._count = 0
        self._end: tuple[int, str] | None = None

    def step(self, line: int) -> None:
        """Count a statement.

        Raises:
            InvalidInput: If there are too many, or the program has ended before it.
        """
        self._count += 1
        if self._count > _MOST_STATEMENTS:
            raise InvalidInput(
                f"the program executes more than {_MOST_STATEMENTS:,} statements, those of called "
                "procedures at every call; check a shorter one."
            )
        if self._end is not None:
            raise InvalidInput(
                f"this never runs, since {self._end[1]} in line {self._end[0]} ends "
                "the program; remove one of them.",
                line=line,
            )

    def move(
        self,
        line: int,
        point: list[float],
        duration: float | None,
        rates: list[float] | None = None,
    ) -> None:
        """Move to a point; the first move leads to the start, and its time does not count."""
        if duration is not None and not 0.0 < duration < math.inf:
            raise InvalidInput(
                f"the move takes {duration:g} s; a time is positive and finite.", line=line
            )
        if self.points:
            if duration is None:
                self._without_time(line, "the move", "has no time")
            self.durations.append(math.nan if duration is None else duration)
        self.points.append(point)
        if rates is not None:
            self.velocities.append(rates)

    def external(self, line: int, axes: Mapping[str, float]) -> None:
        """The external axes of a move's target; one that is not given stays where it is.

        Raises:
            InvalidInput: If one is not where the first move has it, or 0, which is what
                controllers without the axis write.
        """
        if self._external is None:
            self._external = dict(axes)
        for axis, value in axes.items():
            before = self._external.setdefault(axis, 0.0)
            if value != before:
                raise InvalidInput(
                    f"it moves the external axis {axis} to {value:g}, from "
                    f"{before:g}; only robots whose external axes stand still can be checked.",
                    line=line,
                )

    def wait(self, line: int, seconds: float) -> None:
        """Stay at the last point."""
        if not 0.0 <= seconds < math.inf:
            raise InvalidInput(f"a wait of {seconds:g} s; expected a finite time.", line=line)
        if self.points and seconds > 0.0:
            rates = [0.0] * AXES if self.velocities else None
            self.move(line, list(self.points[-1]), seconds, rates)
            self._waits.append(f"line {line}: a wait of {seconds:g} s")

    def pause(self, line: int, word: str) -> None:
        """Stay at the last point for a time that the program does not say."""
        if self.points:
            self._without_time(line, word, "waits for something")

    def speed(self, line: int, word: str) -> None:
        """A setting of speeds or accelerations: moves take longer than they say."""
        self._settings.setdefault(word, {})[line] = None
        self._without_time(line, word, "changes speeds or accelerations")

    def setting(self, line: int, word: str) -> None:
        """A setting of tool, base or load, on which axis moves do not depend."""
        self._settings.setdefault(word, {})[line] = None

    def passed(self, line: int, word: str) -> None:
        """A statement that neither moves the robot nor changes where a move leads."""
        self._passed.setdefault(word, {})[line] = None

    def rounds(self, line: int, mark: str) -> None:
        """A point that the robot rounds; the first one is noted."""
        if not self._rounded:
            self._rounded = True
            self.note(
                f"points are rounded from line {line} on ({mark}): the robot rounds these points; "
                "checked is the path through them"
            )

    def note(self, text: str) -> None:
        """Add a note; the same one once."""
        self._notes[text] = None

    def ends(self, line: int, word: str) -> None:
        """End the program."""
        self._end = line, word

    def _without_time(self, line: int, what: str, why: str) -> None:
        self._untimed = self._untimed or (line, what, why)

    def moves(self, header: dict[str, str]) -> JointMoves:
        """The moves that were read.

        Raises:
            InvalidInput: If there are fewer than two points.
        """
        if len(self.points) < 2:
            raise InvalidInput(
                f"there {'is one joint move' if self.points else 'are no joint moves'} in the "
                "program; expected two or more."
            )
        notes = list(self._notes)
        timed = bool(self.durations) and not math.isnan(sum(self.durations))
        untimed = ""
        if self._untimed is not None:
            line, what, why = self._untimed
            untimed = f"line {line}: {what} {why}"
            notes.append(
                f"{what} of line {line} {why}, so that how long the program takes depends on the "
                "controller"
            )
        if self._external:
            standing = ", ".join(f"{axis} at {value:g}" for axis, value in self._external.items())
            notes.append(
                f"external axes stand still, {standing}: whether the task has them there is not "
                "checked"
            )
        if self._settings:
            notes.append(
                "passed over, since the path of axis moves does not depend on tool, base, load or "
                f"speed (checked is the task's tool): {_listed(self._settings)}"
            )
        if self._passed:
            notes.append(f"passed over, since it does not move the robot: {_listed(self._passed)}")
        durations = np.array(self.durations) if timed and not untimed else None
        velocities: Array | None = None
        if self.velocities:
            if len(self.velocities) != len(self.points):
                raise InvalidInput("some points have velocities, and others have none.")
            velocities = np.array(self.velocities)
        return JointMoves(
            np.array(self.points), durations, velocities, header, tuple(notes),
            tuple(self._waits), untimed,
        )  # fmt: skip


def _listed(words: Mapping[str, Collection[int]]) -> str:
    """Words with the lines where they stand."""
    found = []
    for word, lines in words.items():
        more = f" and {len(lines) - 1} more" if len(lines) > 1 else ""
        found.append(f"{word} (line {next(iter(lines))}{more})")
    if len(found) > _LISTED:
        found[_LISTED:] = [f"and {len(found) - _LISTED} more kinds"]
    return ", ".join(found)


Act = Callable[[int, "re.Match[str]"], "bool | None"]
"""What a statement does, from its line and its match; ``True`` if it ends its procedure."""


class Rules(NamedTuple):
    """The grammar of a language.

    Attributes:
        acts: Patterns of whole statements, and what each does; the first that fits counts.
        reads: What is read, for messages.
    """

    acts: Sequence[tuple[re.Pattern[str], Act]]
    reads: str

    def read(self, statements: Iterable[tuple[int, str]]) -> list[tuple[int, Act, re.Match[str]]]:
        """What statements do, each with its line.

        Raises:
            InvalidInput: At a statement that the grammar does not have.
        """
        found = []
        for number, statement in statements:
            for pattern, act in self.acts:
                if match := pattern.fullmatch(statement):
                    found.append((number, act, match))
                    break
            else:
                word = re.match(r"[\w$/]+", statement, re.ASCII)
                what = f"{word[0]} is not read" if word else "is not understood"
                raise refuse(number, statement, f"{what}; only {self.reads} can be checked.")
        return found


class Procedure(NamedTuple):
    """A procedure without arguments.

    Attributes:
        name: Its name, as messages show it.
        line: Where it begins.
        statements: Its statements with their lines.
    """

    name: str
    line: int
    statements: list[tuple[int, str]]


class Calls:
    """Executes procedures in the order of their calls."""

    def __init__(self, rules: Rules, course: Course, procedures: Mapping[str, Procedure]) -> None:
        """Read the statements of all procedures, called or not.

        Args:
            rules: The grammar.
            course: Where the moves go.
            procedures: By the names with which :meth:`run` is called.

        Raises:
            InvalidInput: At a statement that the grammar does not have.
        """
        self._course = course
        self._procedures = procedures
        self._acts = {
            name: rules.read(procedure.statements) for name, procedure in procedures.items()
        }
        self._running: list[str] = []
        self._called: dict[str, int] = {}

    def run(self, name: str) -> None:
        """Execute a procedure.

        Raises:
            InvalidInput: If procedures call each other in a circle, too deep or too often, or a
                statement stands where it never runs.
        """
        procedure = self._procedures[name]
        if name in self._running or len(self._running) >= _DEEPEST:
            check_callers([*(self._procedures[k].name for k in self._running), procedure.name])
        self._called[name] = self._called.get(name, 0) + 1
        self._running.append(name)
        left = 0
        for number, act, match in self._acts[name]:
            if left:
                raise InvalidInput(
                    f"this never runs, since line {left} leaves {procedure.name} "
                    "before it; remove one of them.",
                    line=number,
                )
            self._course.step(number)
            left = number if act(number, match) else 0
        self._running.pop()

    def note_numbers(self) -> None:
        """Note procedures that were not called once."""
        for name, procedure in self._procedures.items():
            times = self._called.get(name, 0)
            if times != 1:
                often = f"is called {times} times" if times else "is never called, so does not move"
                self._course.note(f"{procedure.name} (line {procedure.line}) {often}")


def check_callers(names: Sequence[str]) -> None:
    """Refuse programs that call each other in a circle, or too deep."""
    if names[-1:] == names[-2:-1]:
        raise InvalidInput(f"{names[-1]} calls itself, so never ends.")
    if len(set(names)) < len(names):
        raise InvalidInput(f"{' calls '.join(names)}: programs call each other in a circle.")
    if len(names) > _DEEPEST:
        raise InvalidInput(
            f"{' calls '.join(names[:3])} …: more than {_DEEPEST} calls inside each other."
        )


def check_identifier(name: str, title: str, longest: int, what: str) -> None:
    """Refuse a program name that the controller does not take.

    Raises:
        InvalidInput: If it is not a letter, then letters, digits and _.
    """
    if not re.fullmatch(r"[A-Za-z][A-Za-z0-9_]*", name) or len(name) > longest:
        raise InvalidInput(
            f"the file's name is the program's, and {title} takes a letter, then letters, digits "
            f"and _, at most {longest} characters ({what}); got {name!r}."
        )
