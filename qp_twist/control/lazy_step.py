"""The result of a compiled step; all fields but the velocity are computed on first access."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import numpy as np

from qp_twist.checks import Array
from qp_twist.constraints import BindingLimit, Named, RowName, binding_limits
from qp_twist.control.step import Status, Step
from qp_twist.kernel import COMPILED
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


class LazyStep(Step):
    """A :class:`Step` of the kernel, by default with all rows met inside all limits.

    Residuals, binding limits, program and σ_min are computed on first access.
    """

    scale = 1.0
    status = Status.SOLVED
    solver = COMPILED
    _met = False
    _numbers: bytes
    _size: Sizes
    _labels: StepLabels
    _rows: Sequence[Named]

    @classmethod
    def made(
        cls,
        velocity: Array,
        numbers: Array,
        size: Sizes,
        labels: StepLabels,
        rows: Sequence[Named],
    ) -> LazyStep:
        """Copy the result of a step: the fields of ``step_record.Program`` up to ``sensitivity``.

        The velocity is a separate copy, so that the caller may modify it.
        """
        step = object.__new__(cls)
        fields = step.__dict__
        fields["velocity"] = velocity.copy()
        fields["_numbers"] = numbers.tobytes()
        fields["_size"], fields["_labels"] = size, labels
        fields["_rows"] = rows
        for source in rows:
            found: tuple[str, ...] = getattr(source, "recovering", ())
            if found:
                fields["recovering"] = step.recovering + found
        return step

    def set_outcome(self, status: Status, scale: float, gaps: tuple[float, ...], met: bool) -> None:
        """Record that the rows are met only at a scale below 1, or not at all.

        ``met``: the program was solved as posed, for less than the task asks.
        """
        fields = self.__dict__
        fields["status"], fields["scale"], fields["gaps"], fields["_met"] = status, scale, gaps, met

    def set_lost(self, later: Callable[[], tuple[LostDirection, ...]]) -> None:
        """Record what computes the directions that this step lacks."""
        self.__dict__["_lost_later"] = later

    @property
    def lost(self) -> tuple[LostDirection, ...]:
        """Directions of the first level of which less is delivered than the task asks."""
        fields = self.__dict__
        if "_lost" not in fields:
            later = fields.pop("_lost_later", None)
            fields["_lost"] = () if later is None else later()
        found: tuple[LostDirection, ...] = fields["_lost"]
        return found

    @lost.setter
    def lost(self, value: tuple[LostDirection, ...]) -> None:
        self.__dict__["_lost"] = value

    def __getattr__(self, name: str) -> Any:
        """Compute a field on first access."""
        if name not in ("residuals", "binding", "problem", "sigma_min"):
            raise AttributeError(name)
        labels = self._labels
        floats = np.frombuffer(self._numbers).copy()
        left: Program = PROGRAM.arrays(
            floats, _NO_INTEGERS, PROGRAM.layout(self._size).table, "sensitivity"
        )
        value: Any
        if name == "residuals":
            missed = left.A @ left.x - left.b - left.eased
            value = tuple(np.split(missed, np.cumsum(labels.ranks)[:-1]))
        elif name == "binding":
            value = self._binding(left)
        elif name == "sigma_min":
            sigma = np.linalg.svd(left.A[: labels.first], compute_uv=False)
            value = float(sigma[-1]) if len(sigma) else np.inf
            if labels.first > len(labels.names):  # more rows than joints
                value = 0.0
        else:
            value = QuadraticProgram(
                left.H, left.c, left.A, left.b, left.G, left.g, left.lower, left.upper
            )
        self.__dict__[name] = value
        return value

    def _binding(self, left: Program) -> tuple[BindingLimit, ...]:
        box, lam, floor, kinds = left.box, left.lam, 1.0, self._labels.kinds
        # Where the program has no solution as posed, the multipliers of the levels count.
        if self.status is not Status.SOLVED and not self._met:
            box, lam, floor = *np.split(left.sensitivity[1:], [len(box)]), 0.0
        box = box[: len(self._labels.names)]  # the slacks of soft bands follow
        # Where there is no bound, the number has no kind.
        lower, upper = (
            [kinds.get(number, "") for number in side.tolist()]
            for side in (left.lower_kind, left.upper_kind)
        )
        found = binding_limits(box, lam, floor, self._labels.names, (lower, upper), self._rows)
        which = int(left.braking[1])
        if which and not found:
            side = "lower" if which > 0 else "upper"
            return (BindingLimit(self._labels.names[abs(which) - 1], "acceleration", side, 1.0),)
        return found

    def __getstate__(self) -> dict[str, Any]:
        """State in which the names of inequality rows replace their limits and tasks."""
        _ = self.lost
        sources = self.__dict__.get("_rows", ())  # missing after dataclasses.replace
        named = tuple(_Names(list(s.names), getattr(s, "weight", None)) for s in sources)
        return self.__dict__ | {"_rows": named}

    def __setstate__(self, state: dict[str, Any]) -> None:
        """Restore the state."""
        self.__dict__.update(state)


class _Names(NamedTuple):
    names: list[RowName]
    weight: float | None
