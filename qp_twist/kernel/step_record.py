"""The program of a step, its result and its workspace, declared once."""

from __future__ import annotations

from typing import Annotated, NamedTuple

from qp_twist.kernel.record import Floats, RecordType, reader


class Sizes(NamedTuple):
    """Sizes of the arrays of a step."""

    nv: int
    m: int
    """Equality rows of all tasks together."""
    tasks: int
    levels: int
    limits: int
    free: int
    """Rows of 1 − T: 6 for each task with the twist-space cost, else 0."""
    others: int
    """nv if other mink tasks add their costs, else 0."""
    k: int
    """Inequality rows."""


class Levels(NamedTuple):
    """Arrays of the levels of a step."""

    gaps: Annotated[Floats, "levels"]
    """Bound on how much longer each level's residual is than at its optimum."""
    Q: Annotated[Floats, "m", "nv"]
    """Orthonormal rows with the span of A: see ``step_kernel.brake``."""
    x: Annotated[Floats, "nv"]
    r: Annotated[Floats, "m"]
    ahead: Annotated[Floats, "m"]
    """The part of b that follows moving targets."""


class Program(NamedTuple):
    """The program min ½xᵀHx + cᵀx, lower ≤ x ≤ upper, A x = b, G x ≤ g; its result; a workspace.

    The result satisfies Hx + c + Aᵀy + Gᵀλ + μ = 0. Fields up to ``sensitivity`` are copied into
    the :class:`~qp_twist.Step`; those after it are workspace.
    """

    c: Annotated[Floats, "nv"]
    x: Annotated[Floats, "nv"]
    lower_kind: Annotated[Floats, "nv"]
    upper_kind: Annotated[Floats, "nv"]
    H: Annotated[Floats, "nv", "nv"]
    A: Annotated[Floats, "m", "nv"]
    G: Annotated[Floats, "k", "nv"]
    lower: Annotated[Floats, "nv"]
    upper: Annotated[Floats, "nv"]
    b: Annotated[Floats, "m"]
    g: Annotated[Floats, "k"]
    eased: Annotated[Floats, "m"]
    """What braking has taken from b below the first level."""
    braking: Annotated[Floats, 2]
    """Share of the first level's speed from which the joints can stop in time; 1 + the joint that
    decides it, or that of a lower level, negative where that moves down, 0 where none does."""
    lacks: Annotated[Floats, 1]
    """Whether a weak direction of the first level has less than it is asked for, 1 or 0."""
    box: Annotated[Floats, "nv"]
    """μ, negative at a lower bound."""
    y: Annotated[Floats, "m"]
    lam: Annotated[Floats, "k"]
    sensitivity: Annotated[Floats, "1 + nv + k"]
    """First s of A x = s b; ``b`` already contains the factor s. Then for each bound (negative at a
    lower one) and row of G: ∂s/∂limit if s < 1; the multiplier if levels were relaxed."""
    q: Annotated[Floats, "nv"]
    levels: Levels
    line: Annotated[Floats, "nv"]
    J: Annotated[Floats, "nv", "nv"]
    R: Annotated[Floats, "m", "m"]
    free: Annotated[Floats, "free", "nv"]
    seen: Annotated[Floats, "nv", "m + free"]
    """The columns of all rows in units of the metric: see ``step_kernel``."""
    directions: Annotated[Floats, "nv", "nv"]
    sigma: Annotated[Floats, "nv"]


PROGRAM = RecordType(Program, Sizes, RecordType(Levels, Sizes))
read_program = reader(PROGRAM)
