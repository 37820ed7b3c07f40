"""The tool axis of a program: by rotary axes, or by a vector."""

from __future__ import annotations

import math
from typing import get_args

from qp_twist.checks import Array
from qp_twist.errors import InvalidInput
from qp_twist.paths.program_block import Block
from qp_twist.paths.program_facts import Facts
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
_ORIGIN = (0.0, 0.0, 0.0)


class ToolAxis:
    """The tool axis as far as a program was read.

    Attributes:
        rotary: How rotary axes turn the tool; ``None`` without any.
        machine: Where X, Y, Z without control of the tip are those of its axes; ``None`` if it is
            not known.
        angles: A, B and C, degrees, as far as they are stated.
        vector: The tool axis by a vector; ``None`` where rotary axes turn it, or nothing does.
        stated: Whether the program states a tool axis.
        vectors: Whether I, J, K of a straight motion are the tool axis.
    """

    def __init__(self, out: ProgramBuilder, facts: Facts) -> None:
        self._out, self._facts = out, facts
        rotary = out.options.rotary
        self.machine: Machine | None = out.options.machine
        self.rotary: Rotary | None = self.machine or (None if rotary == "vector" else rotary)
        self._assumed = ""
        if self.rotary is None and rotary is None:
            self._assume_rotary()
        self._pivots = self._stated_pivots()
        self._letters = rotary_letters(self.rotary) if self.rotary else ("", "")
        self.angles: dict[str, float] = {}
        self.stated = self.vectors = False
        self.vector: tuple[float, ...] | None = None
        self._refused: set[str] = set()

    def _assume_rotary(self) -> None:
        """By ISO 841, A and C, and B and C, turn the tool alike on heads and on tables.

        A and B do not, since their order is open; a single one has no order.
        """
        letters = self._facts.rotary
        if letters not in ("A", "C", "AC", "B", "BC"):
            return
        self._assumed = "nothing states how they turn the tool, which is by ISO 841"
        if self._facts.trunnion:
            # LinuxCNC's xyzac-trt and xyzbc-trt have conventional-directions = 0.
            self._assumed = "LinuxCNC's table of that name turns against ISO 841"
            self.rotary = "table-ac-reversed" if "A" in letters else "table-bc-reversed"
        else:
            self.rotary = "table-bc" if "B" in letters else "table-ac"

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
        return [numbers[:3], numbers[-3:]]

    # ------------------------------------------------------------ what a block states

    def turn(self, block: Block, *, cut: bool) -> dict[str, float]:
        """Read A, B and C of a block; the angles from which they turn, degrees."""
        begin, by_vector = self.angles, self.vector is not None
        if stated := {"A", "B", "C"} & block.words.keys():
            self.angles = dict(begin)
            if by_vector:
                self._end_vector(block)
                begin = {}
        for letter in sorted(stated):
            more = self.angles.get(letter, 0.0) if block.relative(letter) else 0.0
            value = block.words[letter] + more
            known = letter in self._letters
            if value and not known:
                self._refuse(letter)
            if known and letter not in begin and self._out.rows and value and not by_vector:
                raise InvalidInput(
                    f"{letter} is first stated here, after the first motion; where it was before is"
                    " open"
                )
            self.angles[letter] = value
            self.stated |= self.rotary is not None
        if cut and stated and self.rotary is not None:
            return self._begin_of_cut(block, begin)
        return begin

    def _end_vector(self, block: Block) -> None:
        """Rotary axes state the tool axis again, if they all are absolute."""
        letters = (set("".join(self._letters)) or {"A", "B", "C"}) & self._facts.stated
        lacks = sorted(k for k in letters if k not in block.words or block.relative(k))
        if lacks or letters == {"C"}:
            raise InvalidInput(
                f"{lacks[0] if lacks else 'A or B'} is open, since the tool axis was a vector "
                "before; state all rotary axes as absolute angles"
            )
        self.vector = None

    def _refuse(self, letter: str) -> None:
        """Add the problem, once, of a rotary axis that is not known."""
        if self._refused:
            return
        self._refused.add(letter)
        if self.rotary is not None:
            self._out.problem(f"{letter} is not one of the rotary axes of {self.rotary}")
            return
        choices = list(get_args(Machine))
        self._out.problem(
            f"{letter} is a rotary axis; add rotary = to [path] of the task file, how the machine's"
            f" rotary axes turn the tool: {', '.join(choices)}",
            rotary=f"{choices[0]} or another of these",
        )

    def _begin_of_cut(self, block: Block, begin: dict[str, float]) -> dict[str, float]:
        """Angles from which rotary axes turn in a cut; relative ones turn as written."""
        rollover: Rollover = self._out.options.rollover or ROLLOVER
        found = {
            k: angle if block.relative(k) else begin_of_turn(angle, self.angles[k], rollover)
            for k, angle in begin.items()
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
        """Read the tool axis of A3, B3, C3, or of I, J, K; it holds until a rotary axis turns."""
        words = block.words
        letters = BY_VECTOR if not words.keys().isdisjoint(BY_VECTOR) else ("I", "J", "K")
        stated = [letter for letter in letters if letter in words]
        if not stated:
            return
        if letters != BY_VECTOR:
            if not self.vectors and self._out.options.rotary != "vector":
                raise InvalidInput(
                    f"{', '.join(stated)} on a straight motion may be the tool axis; if so, add "
                    'rotary = "vector" to [path] of the task file',
                    options={"rotary": "vector"},
                )
            if len(stated) < 3:
                raise InvalidInput(
                    f"the tool axis has {' and '.join(stated)} alone; whether the others are 0 or "
                    "as before is open. Have the CAM system write I, J and K"
                )
        vector = tuple(words.get(letter, 0.0) for letter in letters)
        if not any(vector):
            raise InvalidInput("the tool axis is zero and has no direction")
        if any(words.get(letter) for letter in "ABC"):
            raise InvalidInput("the tool axis is stated by a vector and by rotary axes; say one")
        self.vector, self.stated = vector, True

    # ------------------------------------------------------------ where it is

    @property
    def turned(self) -> bool:
        """Whether a rotary axis is not at zero."""
        return any(self.angles.values())

    def at(self, begin: dict[str, float], share: float) -> tuple[float, ...]:
        """The tool axis at a share of a motion over which rotary axes move in proportion."""
        if self.vector is not None:
            return self.vector
        if self.rotary is None:
            return 0.0, 0.0, 1.0
        return tool_axis(self.rotary, self._between(begin, share))

    def tip(self, begin: dict[str, float], share: float, axes: list[float]) -> list[float]:
        """The tip at a share of a motion whose X, Y, Z are those of the machine's axes, m."""
        assert self.machine is not None
        scale = self._out.scale()
        pivots = [[scale * value for value in pivot] for pivot in self._pivots]
        return tip(self.machine, pivots, axes, self._between(begin, share))

    def _between(self, begin: dict[str, float], share: float) -> tuple[float, float]:
        """Both angles at a share of a motion, degrees."""
        first, second = (
            (end := self.angles.get(letter, 0.0)) + (share - 1.0) * (end - begin.get(letter, end))
            for letter in self._letters
        )
        return first, second

    def largest_turn(self, begin: dict[str, float]) -> float:
        """Largest turn of a rotary axis in a motion, degrees."""
        if begin is self.angles:
            return 0.0
        return max((abs(end - begin.get(k, end)) for k, end in self.angles.items()), default=0.0)

    def largest_step(self, start: Array, end: Array, *, tip: bool) -> float:
        r"""Degrees by which a rotary axis may turn from point to point: chords stay near the path.

        The end of an arm of length r and a chord of the angle δ are :math:`r \delta^2/8` apart.
        """
        if tip:
            return math.inf
        scale = self._out.scale()
        pivots = [[scale * value for value in pivot] for pivot in (*self._pivots, _ORIGIN)]
        far = max(math.dist(point, pivot) for point in (start, end) for pivot in pivots)
        return math.degrees(math.sqrt(4.0 * self._out.options.arc_error / max(far, 1e-3)))

    # ------------------------------------------------------------ what nothing states

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
        if "tip" in self._refused:
            return
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

    def notes(self) -> list[str]:
        """Notes on how rotary axes were read."""
        found = []
        if self.rotary is not None and self.stated:
            first = "(0, 0, 1) throughout"
            axes = ((row.line, axis) for row in self._out.rows for axis in row.directions)
            leaning = next((each for each in axes if each[1][2] < 1.0 - 1e-12), None)
            if leaning is not None:
                vector = ", ".join(f"{value:.4g}" for value in leaning[1])
                first = f"({vector}) in line {leaning[0]}, the first that leans"
            why = f" ({self._assumed}; {self._out.options.option('rotary')} for another)"
            found.append(
                f"tool axes are those of the rotary axes by {self.rotary}"
                f"{why if self._assumed else ''}: {first}."
            )
        if self._out.options.machine is not None and self.stated:
            pivot = ", ".join(f"{value:g}" for value in self._pivots[0])
            found.append(
                f"X, Y, Z without control of the tip are those of a {self.machine} whose rotary "
                f"axes are at ({pivot}) in the unit of the file."
            )
        return found
