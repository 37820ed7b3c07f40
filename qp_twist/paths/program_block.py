"""A block of a program of a machine tool, as all its languages have it."""

from __future__ import annotations

from dataclasses import dataclass, field

from qp_twist.errors import InvalidInput
from qp_twist.paths.toolpath import LARGEST_NUMBER

BEHIND_SLASH = (
    "a block behind / is run or not by a switch of the machine; take the / or the block out"
)


@dataclass(slots=True)
class Block:
    """A block.

    Attributes:
        words: Numbers by letter or name, such as X or CR; without G and M.
        kinds: Words that are absolute (AC) or relative (IC) by themselves.
        codes: G codes, e.g. 1 or 43.4.
        switches: M codes.
        names: Words without a number, and calls with their arguments, e.g. ``CYCLE800()``.
        corner: How the corner at its end is cut, e.g. ``("R", 2.0)``.
        skipped: Whether it is behind ``/``.
    """

    words: dict[str, float] = field(default_factory=dict)
    kinds: dict[str, str] = field(default_factory=dict)
    codes: list[float] = field(default_factory=list)
    switches: list[float] = field(default_factory=list)
    names: list[str] = field(default_factory=list)
    corner: tuple[str, float] | None = None
    skipped: bool = False

    @property
    def empty(self) -> bool:
        """Whether it has no word."""
        return not (self.words or self.codes or self.switches or self.names or self.skipped)

    def relative(self, name: str) -> bool:
        """Whether a word counts from where the tool is."""
        return self.kinds.get(name) == "IC"

    def take(self, name: str, value: float) -> None:
        """Add a word."""
        if not abs(value) <= LARGEST_NUMBER:
            raise InvalidInput(f"{name}: {value:g} is too large")
        if name == "G":
            self.codes.append(value)
        elif name == "M":
            self.switches.append(value)
        elif name in self.words and name != "T":  # the tool, and the next one
            raise InvalidInput(f"{name} is there twice")
        else:
            self.words[name] = value
