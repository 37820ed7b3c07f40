"""The result of a plain step: numbers now, everything else when it is asked for."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np

from qp_twist.checks import Array
from qp_twist.controller.step import Status, Step
from qp_twist.fast import COMPILED
from qp_twist.limits import DUST, BindingLimit, Named, RowName, binding_bounds
from qp_twist.limits.intersection import Intersection
from qp_twist.qp import QuadraticProgram


class Layout:
    """What all steps of a controller have in common.

    Attributes:
        ranks: Rows of each task.
        rows: Of all of them together.
        first: Of the first level.
        names: Of the joints, by degree of freedom.
        kinds: What bounds come from, by the numbers of ``fast.bounds``.
        dense: Whether H has entries off its diagonal.
    """

    def __init__(
        self,
        ranks: tuple[int, ...],
        first: int,
        names: tuple[str, ...],
        kinds: dict[float, str],
        dense: bool,
    ) -> None:
        """Of a controller's tasks, robot, limits and costs."""
        self.ranks, self.rows, self.first = ranks, sum(ranks), first
        self.names, self.kinds, self.dense = names, kinds, dense


class Numbers(NamedTuple):
    """What a plain step leaves behind, in one array: lower ≤ Wq̇ ≤ upper and its multipliers.

    W is the identity with the rows below it, those of the tasks first.
    """

    c: Array
    x: Array
    lower_kind: Array
    upper_kind: Array
    cost: Array
    """H, or its diagonal where it has no other entries."""
    rows: Array
    """A above G, (m + k, nv)."""
    upper_ends: Array
    """Upper bounds, b and g, (nv + m + k,)."""
    lower_ends: Array
    """Lower bounds, and, where a backend wants it, b and −∞."""
    multipliers: Array
    """μ of the bounds, y and λ."""
    m: int

    @property
    def H(self) -> Array:
        """Of the cost, (nv, nv)."""
        return np.diag(self.cost) if self.cost.ndim == 1 else self.cost

    @property
    def A(self) -> Array:
        """Equality rows, (m, nv)."""
        return self.rows[: self.m]

    @property
    def b(self) -> Array:
        """Their right-hand side, (m,)."""
        return self.upper_ends[len(self.c) : len(self.c) + self.m]

    @property
    def G(self) -> Array:
        """Inequality rows, (k, nv)."""
        return self.rows[self.m :]

    @property
    def g(self) -> Array:
        """Their right-hand side, (k,)."""
        return self.upper_ends[len(self.c) + self.m :]

    @property
    def lower(self) -> Array:
        """Lower bounds, (nv,)."""
        return self.lower_ends[: len(self.c)]

    @property
    def upper(self) -> Array:
        """Upper bounds, (nv,)."""
        return self.upper_ends[: len(self.c)]

    @property
    def box(self) -> Array:
        """μ, (nv,)."""
        return self.multipliers[: len(self.c)]

    @property
    def lam(self) -> Array:
        """λ, (k,)."""
        return self.multipliers[len(self.c) + self.m :]

    @classmethod
    def of(cls, out: Array, layout: Layout) -> Numbers:
        """The parts of the array."""
        m, nv = layout.rows, len(layout.names)
        first = 4 * nv + (nv * nv if layout.dense else nv)
        count = (len(out) - first - 3 * nv) // (nv + 3)  # m + k
        c, x, below, above = out[: 4 * nv].reshape(4, nv)
        cost = out[4 * nv : first].reshape((nv, nv) if layout.dense else (nv,))
        rows = out[first : first + count * nv].reshape(count, nv)
        upper, lower, multipliers = out[first + count * nv :].reshape(3, nv + count)
        return cls(c, x, below, above, cost, rows, upper, lower, multipliers, m)


class PlainStep(Step):
    """A step that met all rows at full speed inside all limits, with what it holds made on demand.

    As :class:`Step`, whose other fields are those of any such step.
    """

    scale = 1.0
    status = Status.SOLVED
    solver = COMPILED
    _numbers: bytes
    _layout: Layout
    _rows: Sequence[Named]
    _box: Intersection | None

    @classmethod
    def made(
        cls,
        velocity: Array,
        numbers: Array,
        layout: Layout,
        rows: Sequence[Named],
        box: Intersection | None = None,
    ) -> PlainStep:
        """From what was left behind in a step's arrays, as :class:`Numbers` reads it.

        ``box`` knows which limit set each bound, where the numbers do not.

        The velocity is a copy of its own: whoever scales it changes nothing else.
        """
        step = object.__new__(cls)
        fields = step.__dict__
        fields["velocity"] = velocity.copy()
        fields["_numbers"] = numbers.tobytes()
        fields["_layout"] = layout
        fields["_rows"] = rows
        fields["_box"] = box
        return step

    def __getattr__(self, name: str) -> Any:
        """What was not asked for before."""
        if name not in ("residuals", "binding", "problem", "sigma_min"):
            raise AttributeError(name)
        layout = self._layout
        numbers = Numbers.of(np.frombuffer(self._numbers).copy(), layout)
        value: Any
        if name == "residuals":
            value = tuple(np.split(numbers.A @ numbers.x - numbers.b, np.cumsum(layout.ranks)[:-1]))
        elif name == "binding":
            value = self._binding(numbers)
        elif name == "sigma_min":
            sigma = np.linalg.svd(numbers.A[: layout.first], compute_uv=False)
            value = float(sigma[-1]) if len(sigma) else np.inf
        else:
            value = QuadraticProgram(
                numbers.H, numbers.c, numbers.A, numbers.b, numbers.G, numbers.g,
                numbers.lower, numbers.upper,
            )  # fmt: skip
        self.__dict__[name] = value
        return value

    def _binding(self, numbers: Numbers) -> tuple[BindingLimit, ...]:
        lam, kinds = numbers.lam, self._layout.kinds
        largest = max(float(np.abs(numbers.box).max(initial=0.0)), float(lam.max(initial=0.0)))
        dust = DUST * max(largest, 1.0)
        lower: Any
        upper: Any
        if self._box is not None:
            lower, upper = self._box.lower_kind, self._box.upper_kind
        else:  # there is a number of no kind where there is no bound
            lower, upper = (
                [kinds.get(number, "") for number in side.tolist()]
                for side in (numbers.lower_kind, numbers.upper_kind)
            )
        found = binding_bounds(numbers.box, dust, self._layout.names, lower, upper)
        pushing = np.flatnonzero(lam > dust).tolist()
        if pushing:
            names = [name for source in self._rows for name in source.names]
            found += [BindingLimit(*names[row], "upper", float(lam[row])) for row in pushing]
        return tuple(found)

    def __getstate__(self) -> dict[str, Any]:
        """Without the limits and tasks that inequality rows come from, but with their names."""
        sources = self.__dict__.get("_rows", ())  # none if it was made by dataclasses.replace
        names = [name for source in sources for name in source.names]
        return self.__dict__ | {"_rows": (_Names(names),) if names else ()}

    def __setstate__(self, state: dict[str, Any]) -> None:
        """As it was."""
        self.__dict__.update(state)


class _Names(NamedTuple):
    names: list[RowName]
