"""The arrays of a step, declared once: its program and result, its inputs, and a workspace."""

from __future__ import annotations

from typing import Annotated, NamedTuple

from qp_twist.kernel.record import Floats, Integers, RecordType, reader

RAISE, SCALE, RELAX = 0, 1, 2
"""If the first level is infeasible: leave it to the reference, scale the task, or minimise its
residual inside the limits."""
FROM_PYTHON = 3
"""Replaces the projector's axes in ``kinds`` if the task's rows are computed in Python."""
(
    DONE, REFUSED, SCALED, RELAXED, PRIORITIZED, INFEASIBLE, AT_THE_EDGE, BRAKED, BRAKED_BELOW,
    FADED,
) = range(10)  # fmt: skip
"""Outcome of a step.

``DONE``: verified, with all rows met. ``REFUSED``: the reference has to compute the step.
``SCALED``: verified with the rows scaled by s < 1. ``RELAXED``: verified, the first level in least
squares. ``PRIORITIZED``: verified, the first of several levels met. ``INFEASIBLE``: no velocity
inside the limits meets all rows.
``AT_THE_EDGE``: a direction is too weak for the error: ``edge_step`` computes the step. ``BRAKED``:
verified, at the share s < 1 from which the joints can stop in time. ``BRAKED_BELOW``: verified, the
first level at full speed and a lower one at such a share. ``FADED``: verified, with less
than the task asks of weak directions.
"""


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


class Settings(NamedTuple):
    """Scalar settings of a controller; flags are 1 or 0."""

    singularity: float
    """ε."""
    weight: float
    """ρ."""
    infeasible: float = RAISE
    """How an infeasible first level is handled."""
    smooth: float = 0.0
    """Whether a step has to change little with its data (``one_program``)."""
    damps_by_error: float = 0.0
    """Whether weak directions are damped by the length of the error."""
    braking: float = 0.0
    """Whether a task is slowed down so that the joints can stop in time."""


class Step(NamedTuple):
    """The program min ½xᵀHx + cᵀx, lower ≤ x ≤ upper, A x = b, G x ≤ g; what it comes from.

    The result satisfies Hx + c + Aᵀy + Gᵀλ + μ = 0. Fields from ``c`` to ``sensitivity`` are copied
    into the :class:`~qp_twist.Step`. For the arrays of inputs see ``twist_rows`` and ``bounds``;
    they come first, where they stay when the number of inequality rows changes.
    """

    settings: Settings
    free_costs: Annotated[Floats, 2]
    """Square roots of the weights of the rows of 1 − T, linear and angular."""
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
    """Unit quaternions and positions, from which ``live_step`` computes R_d and p_d."""
    jacobians: Annotated[Floats, "tasks", 6, "nv"]
    limits: Annotated[Floats, "limits", "nv", 7]
    python_rows: Annotated[Floats, "m", "nv"]
    """Rows of the tasks whose kind is ``FROM_PYTHON``, computed in Python."""
    python_rhs: Annotated[Floats, "m"]
    """Their right-hand sides."""
    python_forward: Annotated[Floats, "m"]
    """The part of them that follows moving targets."""
    python_free: Annotated[Floats, "free", "nv"]
    """Their rows of 1 − T, times the square roots of the weights."""
    quadratic: Annotated[Floats, "others", "nv"]
    """H of other tasks."""
    linear: Annotated[Floats, "others"]
    """c of other tasks."""

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

    gaps: Annotated[Floats, "levels"]
    """Bound on how much longer each level's residual is than at its optimum."""
    q: Annotated[Floats, "nv"]
    ahead: Annotated[Floats, "m"]
    """The part of b that follows moving targets."""
    Q: Annotated[Floats, "m", "nv"]
    """Orthonormal rows with the span of A: see ``step_kernel.brake``."""
    motion: Annotated[Floats, "nv"]
    r: Annotated[Floats, "m"]
    desired: Annotated[Floats, "nv"]
    u: Annotated[Floats, "nv + 1"]
    """To ``lengths`` the workspace of ``dual_active_set``, with ``Q`` as its V and ``J`` as R."""
    L: Annotated[Floats, "nv", "nv"]
    N: Annotated[Floats, "nv", "nv + 1"]
    vectors: Annotated[Floats, 6, "nv + 1"]
    lengths: Annotated[Floats, "k"]
    J: Annotated[Floats, "nv", "nv"]
    R: Annotated[Floats, "m", "m"]
    free: Annotated[Floats, "free", "nv"]
    seen: Annotated[Floats, "nv", "m + free"]
    """The columns of all rows in units of the metric: see ``step_kernel``."""
    directions: Annotated[Floats, "nv", "nv"]
    sigma: Annotated[Floats, "nv"]

    kinds: Annotated[Integers, "tasks", 3]
    """For each task the projector's ranks and axes; or number of rows, 0, ``FROM_PYTHON``."""
    ends: Annotated[Integers, "levels"]
    """Index after the last row of each level."""
    addresses: Annotated[Integers, "nv"]
    """Index of each degree of freedom in q; −1 where it has none of its own."""
    types: Annotated[Integers, "limits"]
    """Kinds of the limits."""
    links: Annotated[Integers, "tasks", "nv"]
    """Which joints move each task's frame: see ``live_step``."""
    sources: Annotated[Integers, "5 + 2 * tasks"]
    """Addresses of MuJoCo's arrays, and the number of joints: see ``live_step``."""
    active: Annotated[Integers, "nv"]
    start: Annotated[Integers, "nv"]
    rows: Annotated[Integers, "m"]
    held: Annotated[Integers, "k + 2 * nv"]


STEP = RecordType(Step)
RESULT = "c", "sensitivity"
"""First and last field of the result."""
read_step = reader(STEP)
