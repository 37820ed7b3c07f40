"""What a step is given, what it leaves behind and its workspace, each declared once."""

from __future__ import annotations

from typing import Annotated, NamedTuple

from qp_twist.fast.compiling import plain
from qp_twist.fast.record import Floats, Integers, Record, reader


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


HEADER = len(Sizes._fields)
"""Entries of the integers that hold the sizes, before everything else."""


class Settings(NamedTuple):
    """Numbers of a controller."""

    twist_space: float
    """Not 0 where the cost is that of twist space."""
    singularity: float
    """Singular value of the rows below which the reference has to look at them."""
    weight: float
    """ρ."""
    nearly_unseen: float
    """Share of the largest singular value below which motion counts, by degrees, as unseen."""
    fastest: float
    """Largest speed that a task or a secondary may ask for, m/s or rad/s."""
    noticeable: float
    """What counts as outside a limit, rad or m."""
    unlimited: float
    """A bound beyond it is none, rad/s or m/s."""
    steepest: float
    """Largest linear cost of other tasks, relative to the largest quadratic one."""
    scales: float
    """Not 0 where rows that do not fit are slowed down; else the reference looks at them."""


class Tolerances(NamedTuple):
    """Of the verification; :mod:`qp_twist.qp.verification` says what each is."""

    equality: float
    optimality: float
    gain: float
    gap: float
    rounding: float
    bound: float


class Given(NamedTuple):
    """What a step is given; the arrays are those of ``twist_rows`` and ``bounds``."""

    settings: Settings
    tolerances: Tolerances
    free_costs: Annotated[Floats, 2]
    """Roots of the weights of the rows of 1 − T, linear and angular."""
    middle: Annotated[Floats, "nv"]
    """θ̄ of the secondary h = displacement + stiffness (θ̄ − θ), rad or m."""
    stiffness: Annotated[Floats, "nv"]
    displacement: Annotated[Floats, "nv"]
    metric: Annotated[Floats, "nv"]
    """Diagonal of M."""
    shapes: Annotated[Floats, "tasks", 27]
    poses: Annotated[Floats, "tasks", 12]
    """R and p of the frames."""
    targets: Annotated[Floats, "tasks", 18]
    """R_d, p_d and the twist of the targets."""
    target_poses: Annotated[Floats, "tasks", 7]
    """Unit quaternions and positions, which ``live_step`` turns into the former."""
    jacobians: Annotated[Floats, "tasks", 6, "nv"]
    limits: Annotated[Floats, "limits", "nv", 7]
    quadratic: Annotated[Floats, "others", "nv"]
    """H of other tasks."""
    linear: Annotated[Floats, "others"]
    """Their c."""
    kinds: Annotated[Integers, "tasks", 3]
    """Of the tasks' projectors."""
    ends: Annotated[Integers, "levels"]
    """Where the rows of each level end."""
    addresses: Annotated[Integers, "nv"]
    """Of the joints in q; −1 where a degree of freedom has none of its own."""
    types: Annotated[Integers, "limits"]
    """Kinds of the limits."""
    links: Annotated[Integers, "tasks", "nv"]
    """Of each task how its frame hangs on the joints: see ``live_step``."""
    sources: Annotated[Integers, "5 + 2 * tasks"]
    """Where MuJoCo's arrays are, and how many joints there are: see ``live_step``."""


class Program(NamedTuple):
    """The program lower ≤ x ≤ upper, A x = b, G x ≤ g; its result; a workspace.

    What a step leaves behind ends with ``gain_lam``. At the result Hx + c + Aᵀy + Gᵀλ + μ = 0.
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
    scale: Annotated[Floats, 1]
    """s in A x = s b: ``b`` here is what was met, s times what the tasks ask."""
    gain_box: Annotated[Floats, "nv"]
    """How much s grows with the room at each bound, negative at a lower one, where s < 1."""
    gain_lam: Annotated[Floats, "k"]
    """The same of each row of G; what a step leaves behind ends here."""
    q: Annotated[Floats, "nv"]
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
    cuts_s: Annotated[Floats, "2 * nv + k", "max(nv - m, 0) + 1"]
    """The program of the largest scale, in s and what the rows leave free; so to ``no_rows_s``."""
    c_s: Annotated[Floats, "max(nv - m, 0) + 1"]
    x_s: Annotated[Floats, "max(nv - m, 0) + 1"]
    u_s: Annotated[Floats, "max(nv - m, 0) + 2"]
    Js: Annotated[Floats, "max(nv - m, 0) + 1", "max(nv - m, 0) + 1"]
    Rs: Annotated[Floats, "max(nv - m, 0) + 1", "max(nv - m, 0) + 1"]
    work_s: Annotated[Floats, 3, "max(nv - m, 0) + 2"]
    no_rows_s: Annotated[Floats, 0, "max(nv - m, 0) + 1"]
    free: Annotated[Floats, "free", "nv"]
    active: Annotated[Integers, "nv"]
    """Those active last time, as many as ``ints[0]`` says."""
    active_s: Annotated[Integers, "nv + 1"]
    ints: Annotated[Integers, "1 + 2 * nv + k"]


GIVEN, PROGRAM = Record(Given, Sizes), Record(Program, Sizes)
read_given, read_program = reader(GIVEN), reader(PROGRAM)


@plain
def read_sizes(integers):
    """The sizes from the first entries of the integers."""
    return Sizes(
        integers[0], integers[1], integers[2], integers[3], integers[4], integers[5], integers[6],
        integers[7], integers[8],
    )  # fmt: skip


@plain
def read_step(floats, integers):
    """Sizes, what is given and the program of a step, from the two arrays that it lies in."""
    size = read_sizes(integers)
    given, i, j = read_given(floats, 0, integers, HEADER, size)
    program, _, _ = read_program(floats, i, integers, j, size)
    return size, given, program
