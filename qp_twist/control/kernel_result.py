"""What the kernel leaves of a step: the attributes that are computed when somebody asks."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np

from qp_twist.constraints import BindingLimit, Named, binding_limits
from qp_twist.kernel.step_record import RESULT, STEP
from qp_twist.kernel.step_record import Step as Arrays
from qp_twist.qp import QuadraticProgram


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


def attribute_of(result: tuple[Any, ...], name: str) -> Any:
    """An attribute of the step that the kernel has left.

    ``result``: a copy of the fields ``RESULT`` of ``step_record.Step`` in bytes, their sizes, the
    labels, what the inequality rows come from, whether the program was solved as posed (else the
    multipliers are those of the levels), and what computes the lost directions.
    """
    numbers, size, labels, sources, as_posed, lost = result
    if name == "lost":
        return lost()
    left: Arrays = STEP.arrays(np.frombuffer(numbers).copy(), STEP.layout(size).table, RESULT)
    if name == "binding":
        return _binding(left, labels, sources, as_posed)
    if name == "residuals":
        missed = left.A @ left.x - left.b - left.eased
        return tuple(np.split(missed, np.cumsum(labels.ranks)[:-1]))
    if name == "problem":
        return QuadraticProgram(
            left.H, left.c, left.A, left.b, left.G, left.g, left.lower, left.upper
        )
    if labels.first > len(labels.names):  # σ_min
        return 0.0
    sigma = np.linalg.svd(left.A[: labels.first], compute_uv=False)
    return float(sigma[-1]) if labels.first else np.inf


def _binding(
    left: Arrays, labels: StepLabels, sources: Sequence[Named], as_posed: bool
) -> tuple[BindingLimit, ...]:
    box, lam, floor = left.box, left.lam, 1.0
    if not as_posed:
        box, lam, floor = *np.split(left.sensitivity[1:], [len(box)]), 0.0
    names = labels.names
    # Where there is no bound, the number has no kind.
    lower, upper = (
        [labels.kinds.get(number, "") for number in side.tolist()]
        for side in (left.lower_kind, left.upper_kind)
    )
    box = box[: len(names)]  # the slacks of soft bands follow
    found = binding_limits(box, lam, floor, names, (lower, upper), sources)
    which = int(left.braking[1])
    if which and not found:
        side = "lower" if which > 0 else "upper"
        return (BindingLimit(names[abs(which) - 1], "acceleration", side, 1.0),)
    return found
