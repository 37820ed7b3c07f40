"""The tool axis of a G-code program: by rotary axes, or by a vector."""

from __future__ import annotations

from typing import get_args

from qp_twist.errors import InvalidInput
from qp_twist.paths.gcode_words import Block
from qp_twist.paths.rotary_axes import (
    ROLLOVER,
    Rollover,
    Rotary,
    begin_of_turn,
    rotary_letters,
    tool_axis,
)
from qp_twist.paths.toolpath_builder import ProgramBuilder, of_lines

BY_VECTOR = ("A3", "B3", "C3")
"""Words of SINUMERIK for a vector."""


class ToolAxis:
    """The tool axis as far as a program was read.

    Attributes:
        rotary: How rotary axes turn the tool; ``None`` without any.
        stated: Whether the program states a tool axis.
        angles: A, B and C, degrees, as far as they are stated.
        vectors: Whether I, J, K of a straight motion are the tool axis.
    """

    def __init__(self, out: ProgramBuilder) -> None:
        self._out = out
        self.rotary: Rotary | None = None if out.options.rotary == "vector" else out.options.rotary
        self.stated = False
        self.angles: dict[str, float] = {}
        self.vectors = False
        self._vector: tuple[float, ...] = (0.0, 0.0, 1.0)
        self._refused = False
        self._rolled_over: list[int] = []
        self._long_turns: list[int] = []

    @property
    def turned(self) -> bool:
        """Whether a rotary axis is not at zero."""
        return any(self.angles.values())

    def turn(self, block: Block, *, relative: bool, cut: bool) -> dict[str, float]:
        """Read A, B and C of a block; the angles from which they turn, degrees."""
        begin = dict(self.angles)
        for letter in sorted({"A", "B", "C"} & block.words.keys()):
            value = block.words[letter] + (self.angles.get(letter, 0.0) if relative else 0.0)
            known = self.rotary is not None and letter in rotary_letters(self.rotary)
            if value and not known and not self._refused:
                self._refused = True
                self._refuse(letter)
            if known and letter not in self.angles and self._out.rows and value:
                raise InvalidInput(
                    f"{letter} is first stated here, after the first motion; where it was before is"
                    " open"
                )
            self.angles[letter] = value
            self.stated |= self.rotary is not None
        if cut and self.rotary is not None:
            return self._begin_of_cut(begin, relative=relative)
        return begin

    def _refuse(self, letter: str) -> None:
        """Add the problem of a rotary axis that is not known."""
        if self.rotary is not None:
            self._out.problem(f"{letter} is not one of the rotary axes of {self.rotary}")
            return
        choices = [name for name in get_args(Rotary) if name != "vector"]
        self._out.problem(
            f"{letter} is a rotary axis; add rotary = to [path] of the task file, how the machine's"
            f" rotary axes turn the tool: {', '.join(choices)}",
            rotary=f"{choices[0]} or another of these",
        )

    def _begin_of_cut(self, begin: dict[str, float], *, relative: bool) -> dict[str, float]:
        """Angles from which rotary axes turn in a cut; by G91 they turn as written."""
        rollover: Rollover = "as-written" if relative else self._out.options.rollover or ROLLOVER
        found = {
            letter: begin_of_turn(angle, self.angles[letter], rollover)
            for letter, angle in begin.items()
        }
        if found != begin:
            self._rolled_over.append(self._out.line)
        if any(abs(self.angles[letter] - angle) > 180.0 for letter, angle in found.items()):
            self._long_turns.append(self._out.line)
        return found

    def read_vector(self, block: Block) -> None:
        """Read the tool axis of I, J, K, or of A3, B3, C3."""
        stated = [letter for letter in ("I", "J", "K") if letter in block.words]
        if block.words.keys() & set(BY_VECTOR):
            vector = tuple(block.words.get(letter, 0.0) for letter in BY_VECTOR)
        elif not stated:
            return
        elif not self.vectors and self._out.options.rotary != "vector":
            raise InvalidInput(
                f"{', '.join(stated)} on a straight motion may be the tool axis; if so, add "
                'rotary = "vector" to [path] of the task file',
                options={"rotary": "vector"},
            )
        elif len(stated) < 3:
            raise InvalidInput(
                f"the tool axis has {' and '.join(stated)} alone; whether the others are 0 or as "
                "before is open. Have the CAM system write I, J and K"
            )
        else:
            vector = tuple(block.words[letter] for letter in stated)
        if not any(vector):
            raise InvalidInput("the tool axis is zero and has no direction")
        if self.turned:
            raise InvalidInput("the tool axis is stated by a vector and by rotary axes; say one")
        self._vector, self.stated = vector, True

    def at(self, begin: dict[str, float], share: float) -> tuple[float, ...]:
        """The tool axis at a share of a motion over which rotary axes move in proportion."""
        if self.rotary is None:
            return self._vector
        angles = {}
        for letter in rotary_letters(self.rotary):
            end = self.angles.get(letter, 0.0)
            angles[letter] = end + (share - 1.0) * (end - begin.get(letter, end))
        return tuple(tool_axis(self.rotary, angles).tolist())

    def largest_turn(self, begin: dict[str, float]) -> float:
        """Largest turn of a rotary axis in a motion, degrees."""
        return max((abs(end - begin.get(k, end)) for k, end in self.angles.items()), default=0.0)

    def notes(self) -> list[str]:
        """Notes on how rotary axes were read."""
        found = []
        if self.rotary is not None and self.stated:
            first = "(0, 0, 1) throughout"
            leaning = (row for row in self._out.rows if row.direction[2] < 1.0 - 1e-12)
            if (row := next(leaning, None)) is not None:
                vector = ", ".join(f"{value:.4g}" for value in row.direction)
                first = f"({vector}) in line {row.line}, the first that leans"
            found.append(f"tool axes are those of the rotary axes by {self.rotary}: {first}.")
        default = " (the default; as-written: the long way)"
        turns = "a rotary axis turns by more than 180 degrees in a cut"
        if self._rolled_over:
            found.append(
                f"{turns} ({of_lines(self._rolled_over)}), as where it rolls over from 360 to 0: it"
                ' takes the short way by rollover = "shortest"'
                f"{default if self._out.options.rollover is None else ''}."
            )
        if self._long_turns:
            found.append(f"{turns} ({of_lines(self._long_turns)}): all the way, as written.")
        return found
