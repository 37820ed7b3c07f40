"""Which pairs a clearance watches in a scene, and which may touch: those that always do."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass

import mujoco
import numpy as np

from qp_twist.checks import Indices
from qp_twist.constraints import (
    LOOKED_AT,
    Clearance,
    never_apart,
    random_configurations,
    touching_share,
)
from qp_twist.constraints.colliding_pairs import body_name, geom_name
from qp_twist.kinematics import JointRanges
from qp_twist.robots.srdf import DisabledPair

DISTANCE = 0.005
"""Distance of a new task, m."""
_OFTEN = 0.05
"""Share of configurations from which two links on either side of a short one touch often."""


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


def watched(
    model: mujoco.MjModel,
    tool: str = "",
    part: str = "",
    disabled: Sequence[DisabledPair] = (),
    srdf: str = "",
) -> Watched | None:
    """What a clearance watches in a scene; ``None`` if no two geoms can collide.

    Ignored are pairs of links that an SRDF disables, and those of :func:`overlapping`: they can
    never be kept apart, or only by chance, such as housings of neighbouring links. What is fixed to
    such a link, as a tool is, is watched all the same. The bodies of a tool and of the part, if
    there are any, may touch.
    """
    if not JointRanges.of(model).only_hinges_and_slides or not len(Clearance(model, 0.0).pairs):
        return None
    ignored = [Ignored(tool, part, "the tool works on the part")] if tool and part else []
    clearance = Clearance(model, DISTANCE, [(pair.one, pair.other) for pair in ignored])
    stated = _of_srdf(clearance, disabled, srdf)
    found = _named(clearance, overlapping(clearance) | stated)
    left = Clearance(model, DISTANCE, [(pair.one, pair.other) for pair in ignored + found])
    notes = [
        f"{len(left.pairs)} pairs of shapes keep {1e3 * DISTANCE:g} mm, of "
        f"{', '.join(_bodies(model, np.unique(left.pairs)))}."
    ]
    if stated:
        notes.append(f"{len(stated)} pairs of shapes may touch, since {srdf} disables them.")
    notes += [
        f"{pair.one} and {pair.other} may touch: {pair.why}."
        for pair in ignored + found
        if pair.why not in stated.values()
    ]
    return Watched(DISTANCE, (*ignored, *found), (*notes, *_without_shape(model, tool)))


def overlapping(clearance: Clearance) -> dict[int, str]:
    """Indices of the pairs of a clearance that may touch, and why.

    * Pairs that are nearer than the distance in every one of many random configurations.
    * Shapes of two moving links with one link between them, which is shorter than one of them is
      thick, if they overlap in more than one configuration of twenty: hulls that reach over a
      wrist. The thickness of a shape is the middle one of the half edges of its box. What is fixed
      to a link, such as a tool, is none of its shapes. An arm that folds onto its base is another
      matter, and watched.
    """
    found = {
        int(pair): f"nearer than {1e3 * clearance.distance:g} mm in each of {LOOKED_AT} random "
        "configurations"
        for pair in never_apart(clearance)
    }
    q = random_configurations(clearance)
    touching = Clearance(clearance.model, 0.0, pairs=clearance.pairs)
    for pair, (length, thickness) in _across_one_link(clearance).items():
        if pair in found or length >= thickness:
            continue
        share = touching_share(touching, pair, q)
        if share > _OFTEN:
            found[pair] = (
                f"neighbours across a link of {1e3 * length:.3g} mm, thicker than that "
                f"({1e3 * thickness:.3g} mm); they overlap in {100.0 * share:.0f} % of {LOOKED_AT} "
                "random configurations"
            )
    return found


def _across_one_link(clearance: Clearance) -> dict[int, tuple[float, float]]:
    """Length of the link between two links of a pair, and the larger thickness of their shapes, m.

    Of pairs of moving links between which there is just one, by hinges.
    """
    model, data = clearance.model, mujoco.MjData(clearance.model)
    mujoco.mj_kinematics(model, data)
    link, parent = model.body_weldid, model.body_parentid
    found: dict[int, tuple[float, float]] = {}
    for pair, geoms in enumerate(clearance.pairs):
        for inner, outer in (model.geom_bodyid[geoms], model.geom_bodyid[geoms[::-1]]):
            between = link[parent[outer]]
            # A body beside these two on the inner link is fixed to it, such as a tool.
            on_inner = (parent[between], link[parent[between]])
            if link[outer] != outer or not between or not link[inner] or inner not in on_inner:
                continue
            joints = model.body_jntadr[[between, outer]]
            if (model.body_jntnum[[between, outer]] != 1).any() or (
                model.jnt_type[joints] != mujoco.mjtJoint.mjJNT_HINGE
            ).any():
                continue
            length = float(np.linalg.norm(np.diff(data.xanchor[joints], axis=0)))
            thickness = np.sort(model.geom_aabb[geoms, 3:], axis=1)[:, 1].max()
            found[pair] = length, float(thickness)
    return found


def _of_srdf(clearance: Clearance, disabled: Iterable[DisabledPair], srdf: str) -> dict[int, str]:
    """Indices of the pairs that an SRDF disables, and why; its links are bodies."""
    model = clearance.model
    reasons = {
        frozenset((pair.one, pair.other)): f"{srdf} disables it"
        + (pair.reason and f": {pair.reason}")
        for pair in disabled
    }
    links = [
        frozenset(str(model.body(int(model.geom_bodyid[geom])).name) for geom in geoms)
        for geoms in clearance.pairs
    ]
    return {pair: reasons[names] for pair, names in enumerate(links) if names in reasons}


def _bodies(model: mujoco.MjModel, geoms: Indices) -> list[str]:
    """Names of the bodies of some geoms, each once; of the world's geoms their own names."""
    names: dict[str, None] = {}
    for geom in geoms:
        body = int(model.geom_bodyid[geom])
        own = str(model.geom(int(geom)).name)
        names[own if body == 0 and own else body_name(model, body)] = None
    return list(names)


def _named(clearance: Clearance, reasons: Mapping[int, str]) -> list[Ignored]:
    """Pairs by indices and reasons as names by which a clearance ignores these pairs alone.

    Those of bodies where all their shapes are meant, else those of geoms; a geom that has no name
    of its own, or that of a body, is counted on its body: ``"wrist geom 2"``.
    """
    model = clearance.model
    apart = set(map(tuple, np.delete(clearance.pairs, list(reasons), axis=0).tolist()))
    found: dict[tuple[str, str], str] = {}
    for pair, why in reasons.items():
        both = clearance.pairs[pair].tolist()
        geoms = [geom_name(model, geom) for geom in both]
        bodies = [body_name(model, int(model.geom_bodyid[geom])) for geom in both]
        counted = [_on_body(model, geom) for geom in both]
        # The world stands for everything that is fixed to it, whatever the scene gets later.
        named = [geoms, bodies] if 0 in model.geom_bodyid[both] else [bodies, geoms]
        for one, other in (*named, counted):
            left = Clearance(model, clearance.distance, [(one, other)]).pairs
            if apart <= set(map(tuple, left.tolist())):
                found.setdefault((one, other), why)
                break
    return [Ignored(*names, why) for names, why in found.items()]


def _on_body(model: mujoco.MjModel, geom: int) -> str:
    """A geom by its number on its body."""
    body = int(model.geom_bodyid[geom])
    return f"{body_name(model, body)} geom {geom - int(model.body_geomadr[body]) + 1}"


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
