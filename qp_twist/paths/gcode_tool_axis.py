"""The tool axis of a G-code program: by rotary axes, or by a vector."""

from __future__ import annotations

import math
from typing import get_args

from qp_twist.checks import Array
from qp_twist.errors import InvalidInput
from qp_twist.paths.gcode_facts import Facts
from qp_twist.paths.gcode_words import Block
from qp_twist.paths.rotary_axes import (
    ROLLOVER,
    Machine,
    Rollover,
    Rotary,
    begin_of_turn,
    rotary_letters,
    tip,
    tool_axis,
)
from qp_twist.paths.toolpath_builder import ProgramBuilder

BY_VECTOR = ("A3", "B3", "C3")
"""Words of SINUMERIK for a vector."""


class ToolAxis:
    """The tool axis as far as a program was read.

    Attributes:
        rotary: How rotary axes turn the tool; ``None`` without any.
        stated: Whether the program states a tool axis.
        angles: A, B and C, degrees, as far as they are stated.
        vectors: Whether I, J, K of a straight motion are the tool axis.
        machine: Where X, Y, Z without control of the tip are those of its axes; ``None`` if it is
            not known.
    """

    def __init__(self, out: ProgramBuilder, facts: Facts) -> None:
        self._out, self._facts = out, facts
        options = out.options
        self.machine: Machine | None = options.machine
        self.rotary: Rotary | None = options.machine or (
            None if options.rotary == "vector" else options.rotary
        )
        self._pivots = self._stated_pivots()
        self._assumed = ""
        if self.rotary is None and options.rotary is None:
            self._assume_rotary()
        self.stated = False
        self.angles: dict[str, float] = {}
        self.vectors = False
        self._vector: tuple[float, ...] = (0.0, 0.0, 1.0)
        self._refused: set[str] = set()

    def _assume_rotary(self) -> None:
        """By ISO 841, A and C, and B and C, turn the tool alike on heads and on tables.

        A and B do not, since their order is open; a single one has no order.
        """
        letters = self._facts.rotary
        if letters in ("A", "C", "AC"):
            self.rotary = "table-ac"
        elif letters in ("B", "BC"):
            self.rotary = "table-bc"
        else:
            return
        if self._facts.trunnion:
            # LinuxCNC's xyzac-trt and xyzbc-trt have conventional-directions = 0.
            self.rotary = "table-ac-reversed" if "A" in letters else "table-bc-reversed"
            self._assumed = "LinuxCNC's table of that name turns against ISO 841"
        else:
            self._assumed = "nothing states how they turn the tool, which is by ISO 841"

    def _stated_pivots(self) -> list[list[float]]:
        """The points of ``pivot``, in the unit of the file: of the first and the second axis."""
        machine, text = self._out.options.machine, self._out.options.pivot
        if text is not None and machine is None:
            raise InvalidInput("pivot belongs to machine; say which one.")
        if text is None and machine is not None and machine.startswith("head"):
            raise InvalidInput(
                "a machine with a head needs pivot: where its rotary axes are, as X,Y,Z from the "
                "tool's tip, in the unit of the file.",
                options={"pivot": "0,0,200"},
            )
        numbers = [float(number) for number in (text or "0,0,0").split(",")]
        both = 2 * numbers if len(numbers) == 3 else numbers
        return [both[:3], both[3:]]

    def assume_machine(self) -> None:
        """A single rotary axis without control of the tip is one of a table through the origin."""
        facts = self._facts
        if self.machine is None and len(facts.rotary) == 1 and not facts.tip:
            assert self.rotary is not None and self.rotary != "vector"
            if not (self._out.options.rotary or "").startswith("head"):
                self.machine = self.rotary
                self._assumed += (
                    f"; the part turns with {facts.rotary} about the file's origin, as on a "
                    "fourth axis"
                )

    def refuse_without_tip(self) -> None:
        """Add the problem, once, of a cut whose X, Y, Z depend on the machine."""
        if "tip" not in self._refused:
            self._refused.add("tip")
            *words, last = self._out.words.tip
            self._out.problem(
                "the rotary axes are turned without control of the tool's tip "
                f"({', '.join(words)} or {last}), so X, Y, Z depend on the dimensions of the "
                "machine; say which machine it is and where its rotary axes are, e.g. machine = "
                '"table-ac" and pivot = "0,0,-50", or have the CAM system write the tip, and '
                f"{words[0]} before it",
                machine=None,
            )

    def tip(self, begin: dict[str, float], share: float, axes: list[float]) -> list[float]:
        """The tip at a share of a motion whose X, Y, Z are those of the machine's axes, m."""
        assert self.machine is not None
        scale = self._out.scale()
        pivots = [[scale * value for value in pivot] for pivot in self._pivots]
        return tip(self.machine, pivots, axes, self._between(begin, share, self.machine))

    def largest_step(self, start: Array, end: Array, *, tip: bool) -> float:
        r"""Degrees by which a rotary axis may turn from point to point: chords stay near the path.

        The end of an arm of length r and a chord of the angle δ are :math:`r \delta^2/8` apart.
        """
        if tip:
            return math.inf
        scale = self._out.scale()
        pivots = [[scale * value for value in pivot] for pivot in (*self._pivots, (0.0, 0.0, 0.0))]
        far = max(math.dist(point, pivot) for point in (start, end) for pivot in pivots)
        return math.degrees(math.sqrt(4.0 * self._out.options.arc_error / max(far, 1e-3)))

    @property
    def turned(self) -> bool:
        """Whether a rotary axis is not at zero."""
        return any(self.angles.values())

    def turn(self, block: Block, *, relative: bool, cut: bool) -> dict[str, float]:
        """Read A, B and C of a block; the angles from which they turn, degrees."""
        begin = dict(self.angles)
        for letter in sorted({"A", "B", "C"} & block.words.keys()):
            more = block.kinds.get(letter, "IC" if relative else "AC") == "IC"
            value = block.words[letter] + (self.angles.get(letter, 0.0) if more else 0.0)
            known = self.rotary is not None and letter in rotary_letters(self.rotary)
            if value and not known and not self._refused:
                self._refused.add(letter)
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
        choices = list(get_args(Machine))
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
        turns = "a rotary axis turns by more than 180 degrees in a cut ({})"
        if found != begin:
            default = " (the default; as-written: the long way)"
            self._out.note(
                f"{turns}, as where it rolls over from 360 to 0: it takes the short way by rollover"
                f' = "shortest"{default if self._out.options.rollover is None else ""}.'
            )
        if any(abs(self.angles[letter] - angle) > 180.0 for letter, angle in found.items()):
            self._out.note(f"{turns}: all the way, as written.")
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
        return tuple(tool_axis(self.rotary, self._between(begin, share, self.rotary)).tolist())

    def _between(self, begin: dict[str, float], share: float, rotary: Rotary) -> dict[str, float]:
        """The angles at a share of a motion, degrees."""
        angles = {}
        for letter in rotary_letters(rotary):
            end = self.angles.get(letter, 0.0)
            angles[letter] = end + (share - 1.0) * (end - begin.get(letter, end))
        return angles

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
            why = f" ({self._assumed}; {self._out.options.option('rotary')} for another)"
            found.append(
                f"tool axes are those of the rotary axes by {self.rotary}"
                f"{why if self._assumed else ''}: {first}."
            )
        if self.machine is not None and self._out.options.machine is not None and self.stated:
            pivot = ", ".join(f"{value:g}" for value in self._pivots[0])
            found.append(
                f"X, Y, Z without control of the tip are those of a {self.machine} whose rotary "
                f"axes are at ({pivot}) in the unit of the file."
            )
        return found
