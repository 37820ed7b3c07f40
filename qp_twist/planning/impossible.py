"""Verdicts before and beside a search: waypoints that no motion can reach, proved on fine grids."""

from __future__ import annotations

import numpy as np

from qp_twist.checks import Indices
from qp_twist.planning.bound import steps_beyond_joints
from qp_twist.planning.certificate import Certificate, empty_layers
from qp_twist.planning.joint_ways import leaves_range
from qp_twist.planning.layer import Layer, centred
from qp_twist.planning.levels import COARSEST, STAGES, Grid, Level, Levels, Roadmap
from qp_twist.planning.manifold_net import COVERED
from qp_twist.planning.prescribed_pairs import too_near
from qp_twist.planning.problem import Problem
from qp_twist.planning.sentence import Sentence

_PROOFS = 12
"""Largest number of waypoints without a configuration that are searched on the finest grid."""
_TRIED, _SEEDING = 16, 2000
"""Numbers of random configurations that are corrected onto each waypoint, and of those found that
are further seeds of waypoints without one."""


def find_impossible(problem: Problem, levels: Levels) -> Certificate | None:
    """What no motion can change: a distance, a waypoint out of reach, a joint's range, a step."""
    grid = levels.grid(STAGES[0], problem.limits.steps)
    for clearance in problem.path_task.clearances:
        near = too_near(problem.path_task, clearance, grid)
        if near is not None:
            return near
    found = _find_unreached(problem.free) or leaves_range(problem, levels)
    return found or _find_beyond_joints(problem, grid)


def _find_beyond_joints(problem: Problem, grid: Grid) -> Certificate | None:
    """Two waypoints, both in reach, further apart than all joints together move the tool."""
    limits = problem.limits
    beyond = steps_beyond_joints(problem.path_task, problem.rows.chain, limits.steps)
    if not len(beyond):
        return None
    first = int(beyond[0])
    ends = [first, first + 1]
    roadmap = Roadmap(problem.path_task, problem.rows, grid)
    level = Level(roadmap, ends, roadmap.layers(ends))
    if level.has_gaps:  # the search tells which waypoint is out of reach, or why
        return None
    note = Sentence("all joints together cannot move the tool so far")
    at = (first + 1, first + 2)
    return Certificate("speed", grid, at, note=note, step_limit=limits.step_limit)


def _find_unreached(problem: Problem) -> Certificate | None:
    """Waypoints that no random configuration reaches, before layers are made of all others.

    For arms without a closed form: an empty layer of theirs is empty whatever the spacing, and the
    configurations found at all waypoints are further seeds.
    """
    count, nv = len(problem.path_task.waypoints), problem.path_task.model.nv
    roadmap = Roadmap(problem.path_task, problem.rows, Grid(STAGES[-1].roll, np.full(nv, COARSEST)))
    if roadmap.arm is not None or problem.freedom > COVERED:
        return None
    ranges, rng = problem.limits.ranges, np.random.default_rng(0)
    at = np.repeat(np.arange(count), _TRIED)
    q, arrived = problem.rows.correct(ranges.random(len(at), rng), at)
    q = centred(q, ranges)
    inside = arrived & ranges.inside(q)
    missed = np.setdiff1d(np.arange(count), at[inside])
    if not len(missed):
        return None
    known = rng.permutation(q[inside])[:_SEEDING]
    seeds = Layer(known, np.zeros(len(known), dtype=np.intp), len(known))
    waypoints = _spread(missed)
    level = Level(roadmap, waypoints, [roadmap.seeded(index, seeds) for index in waypoints])
    return empty_layers(level, covered=True) if level.has_gaps else None


def prove_gaps(problem: Problem, level: Level, levels: Levels) -> Certificate | None:
    """Confirm on the finest grid that waypoints of a level have no configuration, at some of them.

    What is found there instead is added to the ``levels``.
    """
    # The empty ones, and the waypoints skipped on either side of them.
    ends = [level.waypoints[0] - 1, *level.waypoints, level.waypoints[-1] + 1]
    gaps = [k for k, layer in enumerate(level.layers, start=1) if not len(layer.q)]
    skipped = sorted({index for k in gaps for index in range(ends[k - 1] + 1, ends[k + 1])})
    finest = STAGES[-1]
    grid = Grid(finest.roll, np.full(problem.path_task.model.nv, finest.joints))
    roadmap = Roadmap(problem.path_task, problem.rows, grid)

    def reached(waypoints: list[int]) -> Level:
        """The layers, with what is within the tolerances of a check where nothing is exact."""
        layers = zip(waypoints, roadmap.layers(waypoints), strict=True)
        made = [of if of.solutions else roadmap.within_tolerance(index) for index, of in layers]
        return Level(roadmap, waypoints, made)

    proof = reached(_spread(np.array(skipped)))
    if proof.has_gaps:
        return empty_layers(proof, not problem.has_clearance)
    if any(layer.nearby for layer in proof.layers):  # so the others may be, too
        proof = reached(skipped)
    levels.found.update(zip(proof.waypoints, proof.layers, strict=True))
    return None


def _spread(indices: Indices) -> list[int]:
    """Some of the indices, evenly chosen."""
    chosen = np.unique(np.linspace(0, len(indices) - 1, _PROOFS).round().astype(int))
    return [int(index) for index in indices[chosen]]
