"""Which pairs a clearance watches in a scene, and which of them always touch."""

from __future__ import annotations

from dataclasses import dataclass

import mujoco
import numpy as np

from qp_twist.checks import Array, Indices, Mask
from qp_twist.constraints import Clearance
from qp_twist.constraints.colliding_pairs import body_name
from qp_twist.kinematics import JointRanges

DISTANCE = 0.005
"""Distance of a new task, m."""
_LOOKED_AT = 200
"""Number of random configurations."""


@dataclass(frozen=True)
class Ignored:
    """A pair of names that may touch, and why."""

    one: str
    other: str
    why: str


@dataclass(frozen=True, eq=False)
class Watched:
    """What the clearance of a new task watches.

    Attributes:
        distance: m.
        ignored: The pairs that may touch.
        notes: Sentences on what is watched.
    """

    distance: float
    ignored: tuple[Ignored, ...]
    notes: tuple[str, ...]


def watched(model: mujoco.MjModel, tool: str = "", part: str = "") -> Watched | None:
    """What a clearance watches in a scene; ``None`` if no two geoms can collide.

    Pairs that are nearer than the distance in every one of some hundred random configurations can
    never be kept apart, such as housings of neighbouring links, and are ignored.

    Args:
        model: The scene.
        tool: Name of the body of a tool, which may touch the part; or empty.
        part: Name of the body of the part; or empty.
    """
    if not JointRanges.of(model).only_hinges_and_slides or not len(Clearance(model, 0.0).pairs):
        return None
    ignored = [Ignored(tool, part, "the tool works on the part")] if tool and part else []
    clearance = Clearance(model, DISTANCE, [(pair.one, pair.other) for pair in ignored])
    always: Mask = np.asarray((clearance.bounded(_random(model), 0.0) < 0.0).all(axis=0))
    for one, other in _named(model, clearance, always):
        why = f"nearer than {1e3 * DISTANCE:g} mm in each of {_LOOKED_AT} random configurations"
        ignored.append(Ignored(one, other, why))
    left = Clearance(model, DISTANCE, [(pair.one, pair.other) for pair in ignored])
    notes = [
        f"{len(left.pairs)} pairs of shapes keep {1e3 * DISTANCE:g} mm, of "
        f"{', '.join(_bodies(model, np.unique(left.pairs)))}."
    ]
    notes += [f"{pair.one} and {pair.other} may touch: {pair.why}." for pair in ignored]
    return Watched(DISTANCE, tuple(ignored), (*notes, *_without_shape(model, tool)))


def _random(model: mujoco.MjModel) -> Array:
    """Random configurations within the limits, (N, nq); without limits half a turn, or 1 m."""
    ranges = JointRanges.of(model)
    width = np.where(ranges.hinge, np.pi, 1.0)
    low = np.where(ranges.limited, ranges.lower, -width)
    high = np.where(ranges.limited, ranges.upper, width)
    q = np.tile(model.qpos0, (_LOOKED_AT, 1))
    q[:, ranges.qpos] = np.random.default_rng(0).uniform(low, high, (_LOOKED_AT, len(low)))
    return q


def _bodies(model: mujoco.MjModel, geoms: Indices) -> list[str]:
    """Names of the bodies of some geoms, each once; of the world's geoms their own names."""
    names: dict[str, None] = {}
    for geom in geoms:
        body = int(model.geom_bodyid[geom])
        own = str(model.geom(int(geom)).name)
        names[own if body == 0 and own else body_name(model, body)] = None
    return list(names)


def _named(model: mujoco.MjModel, clearance: Clearance, always: Mask) -> list[tuple[str, str]]:
    """Names of the pairs that always touch: of geoms, or of bodies where geoms have none.

    A pair of bodies is left out if it would also ignore geoms that do not always touch.
    """
    touching = {(int(a), int(b)) for a, b in clearance.pairs[always]}
    apart = {(int(a), int(b)) for a, b in clearance.pairs[~always]}
    found: dict[tuple[str, str], None] = {}
    for pair in sorted(touching):
        one, other = (
            str(model.geom(g).name) or str(model.body(int(model.geom_bodyid[g])).name) for g in pair
        )
        if one and other and (one, other) not in found:
            left = Clearance(model, DISTANCE, [(one, other)]).pairs
            if apart <= {(int(a), int(b)) for a, b in left}:
                found[one, other] = None
    return list(found)


def _without_shape(model: mujoco.MjModel, tool: str) -> list[str]:
    """A sentence on moving links on which nothing can collide; a tool is no part of its link."""
    able = (model.geom_contype != 0) | (model.geom_conaffinity != 0)
    bodies = {int(body) for body in model.geom_bodyid[able]}
    if tool:
        bodies.discard(int(model.body(tool).id))
    groups = {int(model.body_weldid[body]) for body in bodies}
    bare = [
        body_name(model, body)
        for body in range(1, model.nbody)
        if model.body_weldid[body] == body and body not in groups
    ]
    if not bare:
        return []
    has, it = ("has", "it") if len(bare) == 1 else ("have", "them")
    return [f"{', '.join(bare)} {has} no shape: nothing is checked for {it}."]
