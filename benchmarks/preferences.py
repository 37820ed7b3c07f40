"""Plans that weigh a preferred lean and roll of the tool beside a search of a fine grid.

    python benchmarks/preferences.py [preferences] [--every 8] [--write]

The deburring run at every so many of its waypoints, with a preferred roll or a smooth one: the grid
has all in-limit joint positions at rolls a degree apart, from the inverse kinematics of
benchmarks/placements.py, and the shortest way through it is searched with costs from their
definitions. A weld whose tool may lean by 20°: at each waypoint all leads and tilts 2° apart, rolls
3° apart, every waypoint for itself, which no motion can be better than by more than the grid is
coarse. Some five minutes.
"""

from page import command, markdown_table

# isort: split
import dataclasses
import itertools
import sys
import time
from typing import NamedTuple

import mink
import numpy as np
from placements import MAX_STEP, InverseKinematics
from scipy.spatial.transform import Rotation

import qp_twist as qt
from qp_twist.checks import Array

LENGTH = 0.3
"""Of the weld, m."""


class Nodes(NamedTuple):
    """Joint positions (K, 6) at a waypoint, mean z of each, and its lead, tilt and roll, rad."""

    q: Array
    z: Array
    values: Array


def nodes(arm: InverseKinematics, pose: mink.SE3, lean: Array, rolls: Array) -> Nodes:
    """All in-limit joint positions with a lean (lead, tilt), rad, at these rolls."""
    found = [arm.inside_with_turns(q) for q in arm.branches(pose, rolls)]
    counts = [len(q) for q in found]
    q = np.concatenate(found)
    values = np.column_stack([np.tile(lean, (len(q), 1)), np.repeat(rolls, counts)])
    return Nodes(q, arm.ranges.centering(q), values)


def cost(preference: qt.Preference, values: Array) -> Array:
    """½ w Σ max(|φ − φ_d| − δ, 0)², by its definition."""
    total = np.zeros(len(values))
    for column, name in enumerate(("lead", "tilt", "roll")):
        preferred = getattr(preference, name)
        if preferred is not None:
            away = (values[:, column] - preferred + np.pi) % (2.0 * np.pi) - np.pi
            total += 0.5 * preference.weight * np.maximum(abs(away) - preference.within, 0.0) ** 2
    return total


def shortest(task: qt.PathTask, preference: qt.Preference, spacing: float) -> float:
    """Value of the best way through the grid, no joint moving more than 15° a waypoint."""
    arm, rolls = InverseKinematics(task), np.radians(np.arange(0.0, 360.0, spacing))
    layers = [nodes(arm, pose, np.zeros(2), rolls) for pose in task.waypoints]
    count = len(layers)
    best = (layers[0].z + cost(preference, layers[0].values)) / count
    for before, after in itertools.pairwise(layers):
        reached = np.full(len(after.q), np.inf)
        for k, q in enumerate(after.q):  # a row at a time: all pairs would fill memory
            near = np.flatnonzero((np.abs(before.q - q) <= MAX_STEP).all(axis=1))
            if len(near):
                turn = before.values[near, 2] - after.values[k, 2]
                turn = (turn + np.pi) % (2.0 * np.pi) - np.pi
                smooth = 0.5 * preference.roll_smoothness * (count - 1) * turn**2
                reached[k] = (best[near] + smooth).min()
        best = reached + (after.z + cost(preference, after.values)) / count
    return float(best.min())


def alone(task: qt.PathTask, preference: qt.Preference, cone: float) -> float:
    """Mean over the waypoints of the best value of each on a grid of leads, tilts and rolls."""
    arm, rolls = InverseKinematics(task), np.radians(np.arange(0.0, 360.0, 3.0))
    grid = np.radians(np.arange(-20.0, 20.1, 2.0))
    leans = np.array(list(itertools.product(grid, grid)))
    leans = leans[np.linalg.norm(leans, axis=1) <= cone + 1e-9]
    total = 0.0
    for pose in task.waypoints:
        R = pose.rotation().as_matrix()
        z, t = R[:, 2], np.array([-1.0, 0.0, 0.0])
        best = np.inf
        for lead, tilt in leans:
            turned = Rotation.from_rotvec(lead * np.cross(z, t) + tilt * t).as_matrix() @ R
            rotation = mink.SO3.from_matrix(turned)
            leaned = mink.SE3.from_rotation_and_translation(rotation, pose.translation())
            found = nodes(arm, leaned, np.array([lead, tilt]), rolls)
            best = min(best, float((found.z + cost(preference, found.values)).min(initial=np.inf)))
        total += best
    return total / len(task.waypoints)


def weld(count: int) -> qt.PathTask:
    """A straight weld along −x, the tool downwards, which may lean by 20°."""
    task = qt.load_task("deburring")
    down = mink.SO3.from_matrix(np.diag([-1.0, 1.0, -1.0]))
    places = [np.array([x, 1.0, 0.6]) for x in np.linspace(LENGTH / 2, -LENGTH / 2, count)]
    cone = qt.ConeBand([0, 0, 1], [0, 0, 1], np.radians(20.0))
    return dataclasses.replace(
        task, name="weld", durations=None, flipped_waypoints=None, roll_normal=None, bands=(cone,),
        waypoints=tuple(mink.SE3.from_rotation_and_translation(down, p) for p in places),
        projector=qt.TwistProjector(linear=qt.Projector.full(), angular=qt.Projector.none()),
    )  # fmt: skip


def preferences(every: int) -> str:
    """Values of plans, and of the grid."""
    run = dataclasses.replace(
        qt.load_task("deburring").part(slice(None, None, every)), durations=None
    )
    roll, lead = np.radians(30.0), np.radians(10.0)
    soft = np.radians(5.0)
    rows = []
    for what, task, preference in (
        ("roll 30°, weight 0.1", run, qt.Preference(roll=roll, weight=0.1)),
        ("roll 30°, weight 1", run, qt.Preference(roll=roll)),
        ("smooth roll, 0.05", run, qt.Preference(roll_smoothness=0.05)),
        ("roll 30°, smooth", run, qt.Preference(roll=roll, weight=0.1, roll_smoothness=0.05)),
        ("lead 10°, ±5° soft, weight 1", weld(7), qt.Preference(lead, 0.0, within=soft)),
        ("weight 10", weld(7), qt.Preference(lead, 0.0, within=soft, weight=10.0)),
    ):
        began = time.process_time()
        plan = qt.plan(dataclasses.replace(task, preference=preference))
        seconds = time.process_time() - began
        if task is run:
            grid = shortest(task, preference, 1.0)
        else:
            grid = alone(task, preference, np.radians(20.0))
        numbers = (f"{plan.value:.4f}", f"{grid:.4f}", f"{plan.value / grid:.4f}")
        rows.append((task.name, what, *numbers, f"{seconds:.1f}", plan.preferred))
        print(*rows[-1], file=sys.stderr, flush=True)
    headings = ("task", "preference", "plan", "grid", "plan / grid", "processor, s", "the plan's")
    return markdown_table(headings, rows)


if __name__ == "__main__":
    sys.exit(command(__doc__, {"preferences": preferences}, every=8))
