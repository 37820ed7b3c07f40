"""The order in which the blocks of a program run: jumps, calls and repetitions."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field

from qp_twist.errors import InvalidInput
from qp_twist.paths.program_values import Variables
from qp_twist.paths.toolpath_builder import ProgramBuilder, TooManyPoints

MOST_REPEATED = 100_000
"""Blocks that may run beside those of the file; beyond it, a loop does not end."""
_DEEPEST = 50
"""Of calls within calls."""


@dataclass
class _Call:
    """A call that runs: where it goes on, how often it runs still, its variables and counts."""

    back: int = -1
    begin: int = 0
    left: int = 1
    local: dict[str, float] = field(default_factory=dict)
    counts: dict[int, int] = field(default_factory=dict)


class Course:
    """Where a program goes on.

    Attributes:
        next: The block that runs next; -1 after the last one.
        variables: Their values so far.
    """

    def __init__(self) -> None:
        self.next, self.variables = 0, Variables()
        self._calls = [_Call(local=self.variables.local)]

    def run(
        self, out: ProgramBuilder, lines: Sequence[int], act: Callable[[int], bool]
    ) -> int | None:
        """Run the blocks until one ends the program. After a problem nothing is run again.

        Args:
            out: Collects the problems.
            lines: The line of each block.
            act: Processes a block; whether it ends the program.

        Returns:
            The line that ends the program, if one does.
        """
        left = len(lines) + MOST_REPEATED
        try:
            while 0 <= self.next < len(lines):
                at, self.next, left = self.next, self.next + 1, left - 1
                ends = False
                with out.at(lines[at]):
                    if left < 0:
                        raise TooManyPoints(
                            f"loops and subprograms run more than {MOST_REPEATED} blocks beside "
                            "those of the file; one does not end, or write the path out"
                        )
                    ends = act(at)
                if ends:
                    return lines[at]
                if out.problems and self.next != at + 1:
                    break
        except TooManyPoints:
            pass  # which is one of the problems
        return None

    def call(self, to: int, times: float = 1, local: dict[str, float] | None = None) -> None:
        """Run a subprogram, then go on here; with variables of its own, or those of the caller."""
        if times > MOST_REPEATED:
            raise InvalidInput(f"{times:g} repeats of a subprogram; at most {MOST_REPEATED} are")
        if len(self._calls) > _DEEPEST:
            raise InvalidInput(f"subprograms call each other more than {_DEEPEST} deep")
        if times >= 1:
            local = self.variables.local if local is None else local
            self._calls.append(_Call(self.next, to, int(times), local))
            self.variables.local, self.next = local, to

    def back(self) -> bool:
        """Go back behind the call that runs, or to its begin; whether one runs."""
        if len(self._calls) == 1:
            return False
        call = self._calls[-1]
        call.left -= 1
        if call.left:
            self.next = call.begin
        else:
            self._calls.pop()
            self.variables.local, self.next = self._calls[-1].local, call.back
        return True

    def counted(self, at: int, times: int) -> bool:
        """Whether what a block repeats is run once more: so many times, then not."""
        counts = self._calls[-1].counts
        left = counts.pop(at, times)
        if left > 0:
            counts[at] = left - 1
        return left > 0

    def forget(self, at: int) -> None:
        """A repetition ends before its time."""
        self._calls[-1].counts.pop(at, None)
