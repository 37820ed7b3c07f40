"""What the kernel leaves of a step: the attributes that are computed when somebody asks."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import numpy as np

from qp_twist.checks import Array
from qp_twist.constraints import BindingLimit, Named, binding_limits
from qp_twist.kernel.step_record import PROGRAM, Program, Sizes
from qp_twist.qp import LostDirection, QuadraticProgram

_NO_INTEGERS = np.zeros(0, dtype=np.int64)


class StepLabels(NamedTuple):
    """Names and row counts, common to all steps of a controller."""

    ranks: tuple[int, ...]
    """Number of rows of each task."""
    first: int
    """Number of rows of the first level."""
    names: tuple[str, ...]
    """Joint name of each degree of freedom."""
    kinds: dict[float, str]
    """Names of the kinds of bounds, by their numbers in ``kernel.bounds``."""


class KernelResult(NamedTuple):
    """A copy of the kernel's numbers."""

    numbers: bytes
    """The fields of ``step_record.Program`` up to ``sensitivity``."""
    size: Sizes
    labels: StepLabels
    sources: Sequence[Named]
    """What the inequality rows come from."""
    as_posed: bool
    """Whether the program was solved as posed; else the multipliers are those of the levels."""
    lost: Callable[[], tuple[LostDirection, ...]]

    def attribute(self, name: str) -> Any:
        """Compute an attribute of the step by its name."""
        if name == "lost":
            return self.lost()
        table = PROGRAM.layout(self.size).table
        floats = np.frombuffer(self.numbers).copy()
        left: Program = PROGRAM.arrays(floats, _NO_INTEGERS, table, "sensitivity")
        if name == "binding":
            return self._binding(left)
        if name == "residuals":
            missed: Array = left.A @ left.x - left.b - left.eased
            return tuple(np.split(missed, np.cumsum(self.labels.ranks)[:-1]))
        if name == "problem":
            return QuadraticProgram(
                left.H, left.c, left.A, left.b, left.G, left.g, left.lower, left.upper
            )
        m, nv = self.labels.first, len(self.labels.names)  # σ_min
        if m > nv:
            return 0.0
        return float(np.linalg.svd(left.A[:m], compute_uv=False)[-1]) if m else np.inf

    def _binding(self, left: Program) -> tuple[BindingLimit, ...]:
        box, lam, floor = left.box, left.lam, 1.0
        if not self.as_posed:
            box, lam, floor = *np.split(left.sensitivity[1:], [len(box)]), 0.0
        names, kinds = self.labels.names, self.labels.kinds
        # Where there is no bound, the number has no kind.
        lower, upper = (
            [kinds.get(number, "") for number in side.tolist()]
            for side in (left.lower_kind, left.upper_kind)
        )
        box = box[: len(names)]  # the slacks of soft bands follow
        found = binding_limits(box, lam, floor, names, (lower, upper), self.sources)
        which = int(left.braking[1])
        if which and not found:
            side = "lower" if which > 0 else "upper"
            return (BindingLimit(names[abs(which) - 1], "acceleration", side, 1.0),)
        return found


def attribute_of(result: tuple[Any, ...], name: str) -> Any:
    """An attribute of the step with these fields of a :class:`KernelResult`."""
    return KernelResult(*result).attribute(name)
