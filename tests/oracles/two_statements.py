"""What a step says to a random composition, and in what two statements of the step differ.

How well an answer is determined is part of it: each composition is asked again after the
configuration was moved by 1e-10 rad and m at random. What the velocity changed by, ``spread``, is
what another statement may differ by; where status or active constraints changed they are not
compared.
"""

from typing import NamedTuple

import numpy as np
import numpy.typing as npt

import qp_twist as qt
from oracles.compositions import Composition, composition

Array = npt.NDArray[np.float64]

NUDGE = 1e-10
"""rad and m."""
VELOCITY = 1e-7
"""Allowed difference of velocities and residuals, as a share of 1 + max |q̇|, besides the spread."""
AMPLIFIED = 100.0
"""How many times the spread is allowed."""


class Answer(NamedTuple):
    """What a step said, or the name of what it raised."""

    status: str
    velocity: Array
    residuals: Array
    scale: float
    sigma_min: float
    active: tuple[str, ...]
    lost: int
    recovering: int


def answer(
    question: Composition, solver: str, nudge: Array | None = None, *, smooth: bool = False
) -> Answer:
    """Ask a composition's controller."""
    none = np.zeros(0)
    try:
        step = question.step(solver, nudge, smooth=smooth)
    except (qt.QpTwistError, ValueError) as error:
        return Answer(type(error).__name__, none, none, np.nan, np.nan, (), 0, 0)
    return Answer(
        step.status.name, step.velocity, np.concatenate([none, *step.residuals]), step.scale,
        step.sigma_min, tuple(sorted(str(limit) for limit in step.binding)), len(step.lost),
        len(step.recovering),
    )  # fmt: skip


class Asked(NamedTuple):
    """An answer with how well it is determined."""

    answer: Answer
    spread: float
    settled: bool
    """Whether status and active constraints stayed when the configuration was nudged."""


def ask(seed: int, solver: str, *, smooth: bool = False) -> Asked:
    """An answer, and how it changes."""
    question = composition(seed)
    first = answer(question, solver, smooth=smooth)
    rng = np.random.default_rng([seed, 21])
    spread, settled = 0.0, True
    for _ in range(2):
        nudge = NUDGE * rng.normal(size=question.model.nv)
        other = answer(question, solver, nudge, smooth=smooth)
        settled &= (other.status, other.active, other.lost) == (
            first.status, first.active, first.lost,
        )  # fmt: skip
        if len(other.velocity) == len(first.velocity):
            spread = max(spread, float(np.abs(other.velocity - first.velocity).max(initial=0.0)))
    return Asked(first, spread, settled)


def differences(mine: Answer, other: Asked) -> list[str]:
    """In what an answer differs from another."""
    theirs, found = other.answer, []
    if other.settled:
        # Where limits hold a level back there may be more of them than unknowns; then multipliers,
        # and with them names, are not unique.
        names = ("status", "active", "lost", "recovering")
        for name in names if theirs.status != "RELAXED" else ("status", "lost", "recovering"):
            if getattr(mine, name) != getattr(theirs, name):
                found.append(f"{name}: {getattr(mine, name)} instead of {getattr(theirs, name)}")
    if mine.velocity.shape != theirs.velocity.shape:
        return found
    size = 1.0 + float(np.abs(theirs.velocity).max(initial=0.0))
    allowed = VELOCITY * size + AMPLIFIED * other.spread
    for name in ("velocity", "residuals"):
        apart = np.abs(getattr(mine, name) - getattr(theirs, name)).max(initial=0.0)
        if not apart <= allowed:
            found.append(f"{name}: {apart:.2g} apart, allowed {allowed:.2g}")
    if other.settled and abs(mine.scale - theirs.scale) > 1e-6 + AMPLIFIED * other.spread:
        found.append(f"scale: {mine.scale} instead of {theirs.scale}")
    return found
