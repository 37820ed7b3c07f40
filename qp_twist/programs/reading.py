"""Parts that the readers share: numbers, statements, calls, and the course of a program.

A reader knows a small grammar of its language: moves, calls, waits, speeds, and statements that
neither move the robot nor change where a move leads. What is not in the grammar is refused.
"""

from __future__ import annotations

import math
import re
from collections import Counter
from collections.abc import Callable, Collection, Mapping, Sequence
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
    for found in re.finditer(r"[,\[\](){}]", text):
        mark, place = found[0], found.start()
        depth += (mark in "[({") - (mark in "])}")
        if mark == "," and depth == 0:
            parts.append(text[start:place].strip())
            start = place + 1
    return [*parts, text[start:].strip()]


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
    if not {*quotes, comment} & set(text):
        code, place = text, len(text)
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
        self._waits: list[tuple[int, str]] = []
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
            self._waits.append((line, f"a wait of {seconds:g} s"))

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
        untimed = None
        if self._untimed is not None:
            line, what, why = self._untimed
            untimed = line, f"{what} {why}"
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
        durations = np.array(self.durations) if timed and untimed is None else None
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
Statements = list[tuple[int, str]]
"""Statements with their lines."""


class Procedure(NamedTuple):
    """A procedure without arguments: its name in messages, its first line, its statements."""

    name: str
    line: int
    statements: Statements


class Program:
    """A program while it is read: its grammar, constants, and procedures in the order of calls.

    A language is a subclass: patterns of its statements. The first group of a pattern is the
    statement's word.

    Attributes:
        course: The points so far.
        procedures: By the names with which they are called.
        values: Texts of variables, as far as they are assigned.
        kinds: Types of variables, as far as they are declared.
    """

    reads = ""
    """What is read, for messages."""
    flags = re.IGNORECASE | re.ASCII | re.DOTALL
    begins, ends, nested = "", "END", False
    """Patterns of the statements that begin a procedure (groups ``name`` and ``arguments``) and end
    it, and whether procedures stand in procedures."""
    data: Sequence[str] = ()
    """Patterns of statements that give a variable a value: groups ``name``, ``value``, and perhaps
    ``kind``, its type, and ``part``, which part of it."""
    noted: Mapping[str, Sequence[str]] = {}
    """Patterns of statements that do not move the robot, by the method of :class:`Course` that
    notes them; their expressions, in group 2, call nothing."""
    reserved: Collection[str] = ()
    """Names to which a program may not give another meaning."""
    twice = "assigned", "targets"
    """What a variable is at several lines that is therefore not read, and what it would be."""

    def __init__(self) -> None:
        self.course = Course()
        self.procedures: dict[str, Procedure] = {}
        self.values: dict[str, str] = {}
        self.kinds: dict[str, str] = {}
        self._assigned: dict[str, list[str]] = {}
        self._acts: dict[str, list[tuple[int, Act, re.Match[str]]]] = {}
        self._running: list[str] = []
        self._called: Counter[str] = Counter()

    def grammar(self) -> Sequence[tuple[str, Act]]:
        """Patterns of whole statements, and what each does; the first that fits counts."""
        raise NotImplementedError

    def noting(self) -> list[tuple[str, Act]]:
        """The grammar of the statements that are noted."""

        def act_of(note: Callable[[int, str], None]) -> Act:
            def act(number: int, match: re.Match[str]) -> None:
                self.check(number, match[0], match[2] if match.re.groups > 1 else "")
                note(number, match[1])

            return act

        return [
            (pattern, act_of(getattr(self.course, kind)))
            for kind, patterns in self.noted.items()
            for pattern in patterns
        ]

    def sort(self, statements: Statements) -> list[str]:
        """Sort statements into procedures; the names of those that stand in no other.

        Statements outside of all are those of the procedure without a name.

        Raises:
            InvalidInput: If a procedure has arguments, no end, or a name with another meaning.
        """
        outside = Procedure("the program", 1, [])
        self.procedures[""] = outside
        top: list[str] = []
        inside = [outside]
        for number, statement in statements:
            begin = re.fullmatch(self.begins, statement, self.flags)
            if begin and (self.nested or len(inside) == 1):
                name = self.name_of(begin["name"])
                if begin["arguments"].strip():
                    raise refuse(number, statement, "procedures with arguments are not read.")
                if name in self.reserved or name in self.procedures:
                    raise refuse(number, statement, "this name has a meaning already.")
                if len(inside) == 1:
                    top.append(name)
                self.procedures[name] = Procedure(begin["name"], number, [])
                inside.append(self.procedures[name])
            elif not re.fullmatch(self.ends, statement, self.flags):
                inside[-1].statements.append((number, statement))
            elif inside.pop() is outside:
                raise refuse(number, statement, "there is nothing above that it ends.")
        if inside[-1] is not outside:
            raise InvalidInput(f"{inside[-1].name} has no end; a line was lost.")
        return top

    def parse(self, name: str, procedure: Procedure) -> list[tuple[int, Act, re.Match[str]]]:
        """Add a procedure; what its statements do, each with its line.

        Raises:
            InvalidInput: At a statement that the grammar does not have.
        """
        rules = [(re.compile(pattern, self.flags), act) for pattern, act in self.grammar()]
        self.procedures[name] = procedure
        self._acts[name] = found = []
        for number, statement in procedure.statements:
            fits = ((act, pattern.fullmatch(statement)) for pattern, act in rules)
            act, match = next(((act, match) for act, match in fits if match), (None, None))
            if act is None or match is None:
                word = re.match(r"[\w$/]+", statement, re.ASCII)
                what = f"{word[0]} is not read" if word else "is not understood"
                raise refuse(number, statement, f"{what}; only {self.reads} can be checked.")
            found.append((number, act, match))
        return found

    def parse_all(self) -> None:
        """Parse all procedures, called or not, and remember where variables get their values."""
        for procedure in self.procedures.values():
            for number, statement in procedure.statements:
                self.assigned(number, statement)
        for name, procedure in self.procedures.items():
            self.parse(name, procedure)

    def assigned(self, place: int | str, statement: str) -> re.Match[str] | None:
        """Remember the line of a statement that gives a variable a value, or declares it again."""
        fits = (re.fullmatch(pattern, statement, self.flags) for pattern in self.data)
        match = next(filter(None, fits), None)
        if match is not None:
            name, kind = self.name_of(match["name"]), match.groupdict().get("kind")
            if match["value"] is not None or (kind and name in self.kinds):
                self._assigned.setdefault(name, []).append(str(place))
            if kind:
                self.kinds[name] = kind.lower()
        return match

    def run(self, name: str) -> None:
        """Execute a procedure.

        Raises:
            InvalidInput: If procedures call each other in a circle, too deep or too often, or a
                statement stands where it never runs.
        """
        procedure = self.procedures[name]
        if name in self._running or len(self._running) >= _DEEPEST:
            names = [*(self.procedures[k].name for k in self._running), procedure.name]
            if names[-1:] == names[-2:-1]:
                raise InvalidInput(f"{names[-1]} calls itself, so never ends.")
            if len(set(names)) < len(names):
                raise InvalidInput(
                    f"{' calls '.join(names)}: programs call each other in a circle."
                )
            raise InvalidInput(
                f"{' calls '.join(names[:3])} …: more than {_DEEPEST} calls inside each other."
            )
        self._called[name] += 1
        self._running.append(name)
        left = 0
        for number, act, match in self._acts[name]:
            if left:
                raise InvalidInput(
                    f"this never runs, since line {left} leaves {procedure.name} "
                    "before it; remove one of them.",
                    line=number,
                )
            self.course.step(number)
            left = number if act(number, match) else 0
        self._running.pop()

    @property
    def running(self) -> str:
        """The procedure that runs."""
        return self._running[-1]

    def note_calls(self) -> None:
        """Note procedures that were not called once."""
        for name, procedure in self.procedures.items():
            times = self._called[name]
            if times != 1:
                often = f"is called {times} times" if times else "is never called, so does not move"
                self.course.note(f"{procedure.name} (line {procedure.line}) {often}")

    def constant(self, number: int, shown: str, name: str, unknown: str) -> str:
        """The text of a variable that is assigned once, before this line is executed.

        Args:
            number: The line.
            shown: The variable as the line has it.
            name: Its name in ``values``.
            unknown: What is wrong if it has no value.
        """
        places, (how, what) = self._assigned.get(name, []), self.twice
        if name not in self.values and len(places) < 2:
            raise refuse(number, shown, unknown)
        if len(places) > 1:
            raise refuse(
                number,
                shown,
                f"is {how} in lines {', '.join(places)}; only {what} that are assigned once can be "
                "checked.",
            )
        return self.values[name]

    def check(self, number: int, statement: str, text: str) -> None:
        """Refuse an expression that calls a function, which might move the robot."""
        if re.search(r"[\w\])}]\s*\(", text, re.ASCII) or ":=" in text:
            raise refuse(
                number,
                statement,
                f"a call in an expression is not read; only {self.reads} can be checked.",
            )

    def calling(self, unknown: str) -> Act:
        """A call of a procedure; ``unknown`` is what is wrong if there is none."""

        def act(number: int, match: re.Match[str]) -> None:
            name = match[1] if match[1] in self.procedures else self.name_of(match[1])
            if name not in self.procedures:
                raise refuse(number, match[0], unknown.format(match[1]))
            self.run(name)

        return act

    def name_of(self, name: str) -> str:
        """A name as it stands in ``procedures``; most languages ignore capitals."""
        return name.upper()

    def end(self, number: int, match: re.Match[str]) -> bool:
        """A statement that ends the program."""
        self.course.ends(number, match[1])
        return True

    def leave(self, number: int, match: re.Match[str]) -> bool:
        """A statement that ends the procedure."""
        return True

    def wait(self, number: int, match: re.Match[str]) -> None:
        """A wait of as many seconds as group 1 has."""
        self.course.wait(number, float(match[1]))


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
