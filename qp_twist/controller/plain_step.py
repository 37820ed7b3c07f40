"""The result of a plain step: numbers now, everything else when it is asked for."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from qp_twist.checks import Array
from qp_twist.controller.step import Status, Step
from qp_twist.limits import DUST, BindingLimit, binding_bounds
from qp_twist.qp import QuadraticProgram

KINDS = ("acceleration", "velocity", "position")
"""Names of what bounds come from, by the numbers of ``fast.bounds``."""


class Layout:
    """What all steps of a controller have in common.

    Attributes:
        ranks: Rows of each task.
        rows: Of all of them together.
        names: Of the joints, by degree of freedom.
        solver: Name of the backend.
        velocity: Where q̇ is among the numbers.
    """

    def __init__(self, ranks: tuple[int, ...], names: tuple[str, ...], solver: str) -> None:
        """Of a controller's tasks, robot and solver."""
        self.ranks, self.rows, self.names, self.solver = ranks, sum(ranks), names, solver
        first = self.rows * len(names) + self.rows + 3 * len(names)
        self.velocity = slice(first, first + len(names))


class Numbers(NamedTuple):
    """What a plain step leaves behind, in one array."""

    A: Array
    b: Array
    c: Array
    lower: Array
    upper: Array
    x: Array
    box: Array
    lower_kind: Array
    upper_kind: Array
    cost: Array
    """H, or its diagonal where it has no other entries."""

    @property
    def H(self) -> Array:
        """Of the cost, (nv, nv)."""
        return np.diag(self.cost) if self.cost.ndim == 1 else self.cost

    @classmethod
    def of(cls, out: Array, layout: Layout) -> Numbers:
        """The parts of the array."""
        rows, nv = layout.rows, len(layout.names)
        square, after = rows * nv, rows * nv + rows
        cost = out[after + 7 * nv :]
        c, lower, upper, x, box, below, above = out[after : after + 7 * nv].reshape(7, nv)
        cost = cost if len(cost) == nv else cost.reshape(nv, nv)
        A, b = out[:square].reshape(rows, nv), out[square:after]
        return cls(A, b, c, lower, upper, x, box, below, above, cost)


class PlainStep(Step):
    """A step that met all rows at full speed inside all limits, with what it holds made on demand.

    As :class:`Step`, whose other fields are those of any such step.
    """

    scale = 1.0
    status = Status.SOLVED
    _numbers: Array
    _layout: Layout

    @classmethod
    def made(cls, numbers: Array, layout: Layout) -> PlainStep:
        """From what was left behind in a step's arrays, as :class:`Numbers` reads it; kept."""
        step = object.__new__(cls)
        fields = step.__dict__
        fields["velocity"] = numbers[layout.velocity]
        fields["_numbers"] = numbers
        fields["_layout"] = layout
        return step

    def __getattr__(self, name: str) -> Any:
        """What was not asked for before."""
        if name not in ("residuals", "binding", "problem", "sigma_min", "solver"):
            raise AttributeError(name)
        layout = self._layout
        numbers = Numbers.of(self._numbers, layout)
        value: Any
        if name == "solver":
            value = layout.solver
        elif name == "residuals":
            value = tuple(np.split(numbers.A @ numbers.x - numbers.b, np.cumsum(layout.ranks)[:-1]))
        elif name == "binding":
            value = self._binding(numbers)
        elif name == "sigma_min":
            sigma = np.linalg.svd(numbers.A, compute_uv=False)
            value = float(sigma[-1]) if len(sigma) else np.inf
        else:
            none = np.zeros((0, len(layout.names)))
            value = QuadraticProgram(
                numbers.H, numbers.c, numbers.A, numbers.b, none, np.zeros(0),
                numbers.lower, numbers.upper,
            )  # fmt: skip
        self.__dict__[name] = value
        return value

    def _binding(self, numbers: Numbers) -> tuple[BindingLimit, ...]:
        dust = DUST * max(float(np.abs(numbers.box).max(initial=0.0)), 1.0)
        # There is a number beyond all kinds where there is no bound.
        kinds = np.minimum((numbers.lower_kind, numbers.upper_kind), len(KINDS)).astype(int)
        lower, upper = np.array((*KINDS, ""), dtype=object)[kinds]
        return tuple(binding_bounds(numbers.box, dust, self._layout.names, lower, upper))
