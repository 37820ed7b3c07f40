"""The program of a step, its result and its workspace, declared once."""

from __future__ import annotations

from typing import Annotated, NamedTuple

from qp_twist.kernel.record import Floats, Integers, RecordType, reader


class Sizes(NamedTuple):
    """Sizes of the arrays of a step."""

    nv: int
    m: int
    """Equality rows of all tasks together."""
    tasks: int
    levels: int
    limits: int
    dense: int
    """nv if H has entries off its diagonal, else 0."""
    free: int
    """Rows of 1 − T: 6 for each task with the twist-space cost, else 0."""
    others: int
    """nv if other mink tasks add their costs, else 0."""
    k: int
    """Inequality rows."""


class ScaleProgram(NamedTuple):
    """The program in the scale s and the null-space coordinates: see ``largest_scale``."""

    cuts: Annotated[Floats, "2 * nv + k", "max(nv - m, 0) + 1"]
    c: Annotated[Floats, "max(nv - m, 0) + 1"]
    x: Annotated[Floats, "max(nv - m, 0) + 1"]
    u: Annotated[Floats, "max(nv - m, 0) + 2"]
    J: Annotated[Floats, "max(nv - m, 0) + 1", "max(nv - m, 0) + 1"]
    R: Annotated[Floats, "max(nv - m, 0) + 1", "max(nv - m, 0) + 1"]
    work: Annotated[Floats, 3, "max(nv - m, 0) + 2"]
    no_rows: Annotated[Floats, 0, "max(nv - m, 0) + 1"]
    nothing: Annotated[Floats, 0]
    held: Annotated[Integers, "2 * nv + k"]
    active: Annotated[Integers, "max(nv - m, 0) + 1"]


class Levels(NamedTuple):
    """Arrays of the levels, solved one after the other if infeasible: see ``closest_levels``."""

    E: Annotated[Floats, "m + nv + k", "nv"]
    """Held rows: those of higher levels at their achieved values, and the active constraints."""
    e: Annotated[Floats, "m + nv + k"]
    x: Annotated[Floats, "nv"]
    previous: Annotated[Floats, "nv"]
    H: Annotated[Floats, "nv", "nv"]
    c: Annotated[Floats, "nv"]
    J: Annotated[Floats, "nv", "nv"]
    R: Annotated[Floats, "nv", "nv"]
    u: Annotated[Floats, "nv + 1"]
    work: Annotated[Floats, 3, "nv + 1"]
    lengths: Annotated[Floats, "k"]
    gaps: Annotated[Floats, "levels"]
    """Bound on how much longer each level's residual is than at its optimum."""
    r: Annotated[Floats, "m"]
    desired: Annotated[Floats, "m"]
    """b of the tasks, while it is replaced by the achieved A x."""
    lower: Annotated[Floats, "nv"]
    upper: Annotated[Floats, "nv"]
    origins: Annotated[Integers, "m + nv + k", 2]
    """Origin of each held row: its kind, and its index in that kind."""
    fixed: Annotated[Integers, "nv"]
    """1 where a bound is held."""
    held_count: Annotated[Integers, 1]
    """Number of held rows."""
    active: Annotated[Integers, "nv"]
    held: Annotated[Integers, "m + 3 * nv + 2 * k"]


class Program(NamedTuple):
    """The program min ½xᵀHx + cᵀx, lower ≤ x ≤ upper, A x = b, G x ≤ g; its result; a workspace.

    The result satisfies Hx + c + Aᵀy + Gᵀλ + μ = 0. Fields up to ``sensitivity`` are copied into
    the :class:`~qp_twist.Step`; those after it are workspace.
    """

    c: Annotated[Floats, "nv"]
    x: Annotated[Floats, "nv"]
    lower_kind: Annotated[Floats, "nv"]
    upper_kind: Annotated[Floats, "nv"]
    h: Annotated[Floats, "nv - dense"]
    """Diagonal of H, if it is diagonal."""
    dense: Annotated[Floats, "dense", "nv"]
    """H, if it is not diagonal."""
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
    box: Annotated[Floats, "nv"]
    """μ, negative at a lower bound."""
    y: Annotated[Floats, "m"]
    lam: Annotated[Floats, "k"]
    sensitivity: Annotated[Floats, "1 + nv + k"]
    """First s of A x = s b; ``b`` already contains the factor s. Then for each bound (negative at a
    lower one) and row of G: ∂s/∂limit if s < 1; the multiplier if levels were relaxed."""
    q: Annotated[Floats, "nv"]
    levels: Levels
    root: Annotated[Floats, "nv"]
    line: Annotated[Floats, "nv"]
    J: Annotated[Floats, "nv", "nv"]
    """S of H⁻¹ = SSᵀ, if H is not diagonal."""
    scaled: Annotated[Floats, "m", "nv"]
    V: Annotated[Floats, "m", "nv"]
    R: Annotated[Floats, "m", "m"]
    null_basis: Annotated[Floats, "max(nv - m, 0)", "nv"]
    """Basis of the null space of A."""
    cuts: Annotated[Floats, "2 * nv + k", "max(nv - m, 0)"]
    """Bounds and rows of G in these coordinates."""
    ends: Annotated[Floats, "2 * nv + k"]
    lengths: Annotated[Floats, "2 * nv + k"]
    zero: Annotated[Floats, "max(nv - m, 0)"]
    z: Annotated[Floats, "max(nv - m, 0)"]
    u: Annotated[Floats, "max(nv - m, 0) + 1"]
    work_z: Annotated[Floats, 3, "max(nv - m, 0) + 1"]
    Jz: Annotated[Floats, "max(nv - m, 0)", "max(nv - m, 0)"]
    Rz: Annotated[Floats, "max(nv - m, 0)", "max(nv - m, 0)"]
    no_rows: Annotated[Floats, 0, "max(nv - m, 0)"]
    nothing: Annotated[Floats, 0]
    scaling: ScaleProgram
    free: Annotated[Floats, "free", "nv"]
    seen: Annotated[Floats, "m + free", "dense"]
    """All rows in units of the metric: see ``step_kernel``."""
    directions: Annotated[Floats, "dense", "dense"]
    sigma: Annotated[Floats, "dense"]
    active: Annotated[Integers, "nv"]
    """Constraints that were active in the last step: lower bounds are numbered from 0, upper bounds
    from nv, rows of G from 2 nv."""
    active_count: Annotated[Integers, 1]
    """Number of these."""
    held: Annotated[Integers, "2 * nv + k"]


PROGRAM = RecordType(Program, Sizes, RecordType(ScaleProgram, Sizes), RecordType(Levels, Sizes))
read_program = reader(PROGRAM)
