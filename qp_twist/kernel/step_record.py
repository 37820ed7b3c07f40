"""The program of a step, its result and its workspace, declared once."""

from __future__ import annotations

from typing import Annotated, NamedTuple

from qp_twist.kernel.record import Floats, Integers, Record, reader


class Sizes(NamedTuple):
    """How long everything in a step is."""

    nv: int
    m: int
    """Equality rows of all tasks together."""
    tasks: int
    levels: int
    limits: int
    dense: int
    """nv where H has entries off its diagonal, else 0."""
    free: int
    """Rows of 1 − T, 6 for each task, in twist space, else 0."""
    others: int
    """nv where other tasks add their costs, else 0."""
    k: int
    """Inequality rows."""


class ScaleProgram(NamedTuple):
    """The program in s and what the rows leave free: see ``largest_scale``."""

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
    """The levels one after the other, where they do not fit: see ``closest_levels``."""

    E: Annotated[Floats, "m + nv + k", "nv"]
    """Rows that are held: what levels achieve, and what stands in their way."""
    e: Annotated[Floats, "m + nv + k"]
    x: Annotated[Floats, "nv"]
    before: Annotated[Floats, "nv"]
    H: Annotated[Floats, "nv", "nv"]
    c: Annotated[Floats, "nv"]
    J: Annotated[Floats, "nv", "nv"]
    R: Annotated[Floats, "nv", "nv"]
    u: Annotated[Floats, "nv + 1"]
    work: Annotated[Floats, 3, "nv + 1"]
    lengths: Annotated[Floats, "k"]
    gaps: Annotated[Floats, "levels"]
    """By how much the residual of each may be longer than at its optimum."""
    r: Annotated[Floats, "m"]
    asked: Annotated[Floats, "m"]
    lower: Annotated[Floats, "nv"]
    upper: Annotated[Floats, "nv"]
    origins: Annotated[Integers, "m + nv + k", 2]
    """Of the held rows: what they are, and their number."""
    fixed: Annotated[Integers, "nv"]
    """1 where a bound is held."""
    many: Annotated[Integers, 1]
    """How many rows are held."""
    active: Annotated[Integers, "nv"]
    held: Annotated[Integers, "m + 3 * nv + 2 * k"]


class Program(NamedTuple):
    """The program lower ≤ x ≤ upper, A x = b, G x ≤ g; its result; a workspace.

    What a step leaves behind ends with ``gains``. At the result Hx + c + Aᵀy + Gᵀλ + μ = 0.
    """

    c: Annotated[Floats, "nv"]
    x: Annotated[Floats, "nv"]
    lower_kind: Annotated[Floats, "nv"]
    upper_kind: Annotated[Floats, "nv"]
    h: Annotated[Floats, "nv - dense"]
    """Diagonal of H where it has no other entries."""
    dense: Annotated[Floats, "dense", "nv"]
    """H where it has."""
    A: Annotated[Floats, "m", "nv"]
    G: Annotated[Floats, "k", "nv"]
    lower: Annotated[Floats, "nv"]
    upper: Annotated[Floats, "nv"]
    b: Annotated[Floats, "m"]
    g: Annotated[Floats, "k"]
    box: Annotated[Floats, "nv"]
    """μ, negative at a lower bound."""
    y: Annotated[Floats, "m"]
    lam: Annotated[Floats, "k"]
    gains: Annotated[Floats, "1 + nv + k"]
    """s of A x = s b: ``b`` is what was met, s times what the tasks ask. Where s < 1, how much s
    grows with the room at each bound, negative at a lower one, and at each row of G; where levels
    give way, the multipliers of what stands in the way. What a step leaves behind ends here."""
    q: Annotated[Floats, "nv"]
    levels: Levels
    root: Annotated[Floats, "nv"]
    line: Annotated[Floats, "nv"]
    J: Annotated[Floats, "nv", "nv"]
    """S of H⁻¹ = SSᵀ where H has entries off its diagonal."""
    scaled: Annotated[Floats, "m", "nv"]
    V: Annotated[Floats, "m", "nv"]
    R: Annotated[Floats, "m", "m"]
    ways: Annotated[Floats, "max(nv - m, 0)", "nv"]
    """What the rows leave free."""
    cuts: Annotated[Floats, "2 * nv + k", "max(nv - m, 0)"]
    """Bounds and rows of G on it."""
    ends: Annotated[Floats, "2 * nv + k"]
    lengths: Annotated[Floats, "2 * nv + k"]
    zero: Annotated[Floats, "max(nv - m, 0)"]
    z: Annotated[Floats, "max(nv - m, 0)"]
    u: Annotated[Floats, "max(nv - m, 0) + 1"]
    three: Annotated[Floats, 3, "max(nv - m, 0) + 1"]
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
    """Constraints that were active last time: lower bounds from 0, upper ones from nv and rows of G
    from 2 nv on."""
    active_count: Annotated[Integers, 1]
    """How many they are."""
    held: Annotated[Integers, "2 * nv + k"]


PROGRAM = Record(Program, Sizes, Record(ScaleProgram, Sizes), Record(Levels, Sizes))
read_program = reader(PROGRAM)
