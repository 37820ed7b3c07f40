"""Parts that the readers share: numbers, names, and what a statement may be."""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Iterable, Sequence
from typing import NamedTuple

import numpy as np

from qp_twist.checks import Array
from qp_twist.errors import InvalidInput
from qp_twist.programs.joint_moves import AXES, JointMoves

NUMBER = r"[-+]?(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?"
LONGEST = 80
"""Characters of a statement that messages show."""


def shown(text: str) -> str:
    """A statement as messages show it."""
    text = " ".join(text.split())
    return repr(text if len(text) <= LONGEST else text[: LONGEST - 1] + "…")


def refuse(line: int, text: str, why: str) -> InvalidInput:
    """The error for a statement."""
    return InvalidInput(f"line {line}: {shown(text)}: {why}")


def number_of(line: int, text: str, name: str = "a number") -> float:
    """A finite number, as programs write them."""
    if not re.fullmatch(NUMBER, text.strip()) or not math.isfinite(float(text)):
        raise refuse(line, text, f"expected {name}.")
    return float(text)


def six(line: int, texts: Sequence[str]) -> list[float]:
    """Six numbers."""
    if len(texts) != AXES:
        raise refuse(line, ", ".join(texts), f"expected {AXES} angles, got {len(texts)}.")
    return [number_of(line, text, "an angle") for text in texts]


class Course:
    """Points and times of a program while it is read.

    A move without a time, such as one at a share of the largest speed, leaves the whole program
    without times: how long it takes depends on the controller.
    """

    def __init__(self) -> None:
        self.points: list[list[float]] = []
        self.durations: list[float] = []
        self.velocities: list[list[float]] = []
        self.untimed: int | None = None
        self.notes: list[str] = []
        self._passed: dict[str, list[int]] = {}

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
                f"line {line}: the move takes {duration:g} s; a time is positive and finite."
            )
        if self.points:
            if duration is None:
                self.untimed = line if self.untimed is None else self.untimed
            self.durations.append(math.nan if duration is None else duration)
        self.points.append(point)
        if rates is not None:
            self.velocities.append(rates)

    def wait(self, line: int, seconds: float) -> None:
        """Stay at the last point."""
        if not 0.0 <= seconds < math.inf:
            raise InvalidInput(f"line {line}: a wait of {seconds:g} s; expected a finite time.")
        if self.points and seconds > 0.0:
            rates = [0.0] * AXES if self.velocities else None
            self.move(line, list(self.points[-1]), seconds, rates)

    def passed(self, line: int, word: str) -> None:
        """Note a statement that does not move the robot."""
        self._passed.setdefault(word, []).append(line)

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
        notes = list(self.notes)
        if self.untimed is not None:
            notes.append(
                f"the move of line {self.untimed} has no time, so that how long the program takes "
                "depends on the controller"
            )
        if self._passed and not header:
            words = ", ".join(
                f"{word} (line {lines[0]}{f' and {len(lines) - 1} more' if len(lines) > 1 else ''})"
                for word, lines in self._passed.items()
            )
            notes.append(f"passed over, since it does not move the robot: {words}")
        durations: Array | None = None if self.untimed is not None else np.array(self.durations)
        velocities: Array | None = None
        if self.velocities:
            if len(self.velocities) != len(self.points):
                raise InvalidInput("some points have velocities, and others have none.")
            velocities = np.array(self.velocities)
        return JointMoves(np.array(self.points), durations, velocities, header, tuple(notes))


class Rules(NamedTuple):
    """What statements of a language are, in this order.

    Attributes:
        acts: Patterns of whole statements, and what to do with each.
        refused: How statements begin that move the robot in other ways, or branch.
        passed: How statements begin that do not move it; the first group names them.
        reads: What is read, for messages.
    """

    acts: Sequence[tuple[re.Pattern[str], Callable[[int, re.Match[str]], None]]]
    refused: re.Pattern[str]
    passed: re.Pattern[str]
    reads: str

    def follow(self, statements: Iterable[tuple[int, str]], course: Course) -> None:
        """Read statements, each with its line.

        Raises:
            InvalidInput: At a statement that is none of these, or is refused.
        """
        for number, statement in statements:
            for pattern, act in self.acts:
                if match := pattern.fullmatch(statement):
                    act(number, match)
                    break
            else:
                if match := self.refused.search(statement):
                    raise refuse(
                        number,
                        statement,
                        f"{match[1]} is not read; only {self.reads} can be checked.",
                    )
                match = self.passed.match(statement)
                if match is None:
                    raise refuse(
                        number, statement, f"is not understood; only {self.reads} can be checked."
                    )
                course.passed(number, match[1])


def nothing(number: int, match: re.Match[str]) -> None:
    """For statements that frame a program."""
    del number, match


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


def without_repeats(files: Sequence[str]) -> None:
    """Refuse programs that call each other in a circle."""
    if len(set(files)) < len(files):
        raise InvalidInput(f"{' calls '.join(files)}: programs call each other in a circle.")
