"""Pairs of geoms that no motion takes apart: their shapes overlap in every configuration."""

from __future__ import annotations

import numpy as np

from qp_twist.checks import Array, Indices
from qp_twist.constraints.clearance import Clearance
from qp_twist.errors import InvalidInput
from qp_twist.kinematics import JointRanges

LOOKED_AT = 2000
"""Number of random configurations."""
_FIRST = 8
"""Number of these in which every pair is looked at; few are left for the others."""
_NAMED = 4
"""Largest number of pairs that a message names."""


def random_configurations(clearance: Clearance) -> Array:
    """Random configurations inside the joint limits, (N, nq), always the same ones."""
    ranges = JointRanges.of(clearance.model)
    q = np.tile(clearance.model.qpos0, (LOOKED_AT, 1))
    q[:, ranges.qpos] = ranges.random(LOOKED_AT, np.random.default_rng(0))
    return q


def never_apart(clearance: Clearance) -> Indices:
    """Indices of the pairs that are nearer than the distance in every random configuration."""
    if not len(clearance.pairs):
        return np.zeros(0, dtype=np.intp)
    q = random_configurations(clearance)
    left = np.flatnonzero((clearance.bounded(q[:_FIRST], 0.0) < 0.0).all(axis=0))
    return left[[touching_share(clearance, int(pair), q) == 1.0 for pair in left]]


def touching_share(clearance: Clearance, pair: int, q: Array) -> float:
    """Share of configurations q (N, nq) in which a pair is nearer than the distance."""
    alone = Clearance(clearance.model, clearance.distance, pairs=clearance.pairs[[pair]])
    return float((alone.first_violated(q) >= 0).mean())


def refuse_never_apart(name: str, clearance: Clearance) -> None:
    """Refuse the clearance of the task ``name`` that no motion keeps.

    The message has the names of the pairs as they are written into the task file.
    """
    always = [clearance.names[k] for k in never_apart(clearance)]
    if not always:
        return
    more = f" and {len(always) - _NAMED} more" if len(always) > _NAMED else ""
    pairs = ", ".join('["' + '", "'.join(pair.split(" to ", 1)) + '"]' for pair in always[:_NAMED])
    raise InvalidInput(
        f"{name}: a clearance of {clearance.distance:g} m cannot be kept: in each of {LOOKED_AT} "
        f"random configurations these pairs are nearer: {', '.join(always[:_NAMED])}{more}. If "
        f"they may touch, write into the task file, [clearance], ignore = [{pairs}], in Python "
        "qt.Clearance(..., ignore=...); else ask for less (the distance is in m: 5 mm is 0.005)."
    )
