"""Clearance: plans beside an exhaustive search in random cells, and steps in front of walls.

    python benchmarks/cells.py [random_cells] [--cells 20] [--first 0] [--every 10] [--roll-step 2]
        [--jobs 1] [--keep DIR] [--write]
    python benchmarks/cells.py [crowded_cells] [--cells 20] [--first 0] [--jobs 1] [--write]
    python benchmarks/cells.py [walls] [--runs 5] [--first 0] [--jobs 1] [--keep DIR] [--write]
    python benchmarks/cells.py [wall_times] [--first 0] [--blocks 12] [--write]

*random_cells*: the deburring part stands as a study places it, with 1 to 6 boxes and cylinders
around it, in front of an arm whose links are capsules, cylinders and boxes. An exhaustive search
(every n-th waypoint; rolls 2° apart, all branches and full turns; distances by coal) finds
the motion of least mean z whose waypoints keep 5 mm, and, by leaving out connections that come
nearer between the waypoints, the one that keeps it there as well. It shares nothing with the plan.
Cell ``--first K --cells 1`` is always the same; each cell is printed to the standard error.

*crowded_cells*: processor time of plans of 401 waypoints among ten obstacles, over that of the same
plan without clearance.

*walls*: a controller at 200 Hz pulls the tool of an arm of seven axes through a wall, into a
corner and along with an obstacle that moves, from random starts, without and with acceleration
limits, beside mink's collision limit on the same pairs for the first five of the starts.

*wall_times*: the time of such a step, ``Controller.step`` beside ``mink.solve_ik``.

With ``--keep DIR`` each result is kept in a file of its own, and is not computed again: a count can
be stopped, and go on with more. Results of another version of the code have to be removed by hand.
"""

from page import command, each, in_processes, markdown_table

# isort: split
import dataclasses
import itertools
import json
import sys
import time
from collections import Counter
from typing import Any, NamedTuple

import mink
import mujoco
import numpy as np
import numpy.typing as npt
from oracles.arms import seven_axes
from oracles.distances import Distances
from placements import InverseKinematics
from scipy.spatial import cKDTree
from timer import LEAD_IN, SplitStep, interleaved

import qp_twist as qt
from qp_twist.checks import Array
from qp_twist.studies.sample import draw_sample

# ---------------------------------------------------------------- cells

CLEAR = 0.005
"""Distance to keep, m."""
BETWEEN = 1e-4
"""By how much less a plan may keep between two waypoints, m."""
STEP = np.radians(15.0)
FREE_OF = 0.05
"""Obstacles keep this far from the tool's tip and from its spindle on the path, m."""
SHOULDER, COLUMN = np.array([0.15, 0.0, 0.525]), 0.3
"""Where the upper arm begins, and the radius in which the first link turns, m."""
INSIDE = 20
"""Points of each step at which the clearance of the plan and of the search is looked at."""
OBSTACLES = 10
"""Number of obstacles of a crowded cell."""
REPEATED = 3
"""How often both plans of a crowded cell are made, in turn; the times are medians."""
TRIALS = 4000
"""How often the search leaves out connections before it gives up."""

LINKS: tuple[tuple[str, str, tuple[float, ...], tuple[float, ...]], ...] = (
    ("base", "cylinder", (0.2,), (0, 0, 0, 0, 0, 0.25)),
    ("link_1", "capsule", (0.14,), (0, 0, -0.1, 0.10, 0, 0)),
    ("link_1", "cylinder", (0.12,), (0.15, -0.07, 0, 0.15, 0.23, 0)),
    ("link_2", "box", (0.12, 0.045, 0.47), (0, -0.125, 0.385)),
    ("link_3", "box", (0.2, 0.09, 0.1), (-0.07, 0, 0.08)),
    ("link_4", "capsule", (0.07,), (0.2, 0, 0, 0.7, 0, 0)),
    ("link_5", "capsule", (0.05,), (0.0, 0, 0, 0.05, 0, 0)),
)
"""Geoms of the links: body, kind, sizes, and ends or centre in the body's frame, m."""
TOOL = (
    ("cylinder", (0.045,), (0, 0, 0, 0, 0, 0.055), "flange"),
    ("capsule", (0.03,), (0, 0, 0.06, -0.04, 0, 0.15), "flange"),
    ("cylinder", (0.035,), (0, 0, -0.232, 0, 0, -0.082), "tool"),
    ("capsule", (0.008,), (0, 0, -0.07, 0, 0, -0.03), "tool"),
)
"""Geoms on the last link: kind, sizes, ends in the frame of a site."""

COLLIDES = {"contype": 1, "conaffinity": 1}
"""The scene's own geoms do not."""


def kind_of(name: str) -> mujoco.mjtGeom:
    """MuJoCo's number of a kind of geom."""
    return getattr(mujoco.mjtGeom, f"mjGEOM_{name.upper()}")


def add_links(spec: mujoco.MjSpec) -> None:
    """Give the arm, the part and the floor shapes that collide."""
    plain = spec.compile()
    for number, (body, kind, size, place) in enumerate(LINKS):
        where = {"fromto": place} if len(place) == 6 else {"pos": place}
        spec.body(body).add_geom(
            name=f"{body} shape {number}",
            type=kind_of(kind),
            size=_three(size),
            **where,
            **COLLIDES,
        )
    for number, (kind, size, place, name) in enumerate(TOOL):
        site = plain.site(name)
        R = mink.SO3(plain.site_quat[site.id]).as_matrix()
        ends = np.reshape(place, (2, 3)) @ R.T + plain.site_pos[site.id]
        spec.body("link_6").add_geom(
            name=f"tool shape {number}",
            type=kind_of(kind),
            size=_three(size),
            fromto=ends.ravel(),
            **COLLIDES,
        )
    for name in ("floor", "part", "fixture"):
        geom = spec.geom(name)
        geom.contype = geom.conaffinity = 1


def _three(size: tuple[float, ...]) -> list[float]:
    return [*size, 0.0, 0.0][:3]


def add_obstacles(
    spec: mujoco.MjSpec, task: qt.PathTask, rng: np.random.Generator, wanted: int
) -> None:
    """Put so many boxes and cylinders around the part, or between it and the arm's shoulder.

    None stands in the tool's own way, nor in the column that the arm turns in.
    """
    tips = task.positions
    axes = np.array([w.rotation().as_matrix()[:, 2] for w in task.waypoints])
    points = np.concatenate([tips - back * axes for back in (0.0, 0.1, 0.2)])
    centre = tips.mean(axis=0)
    number = 0
    while number < wanted:
        away = rng.normal(size=3)
        away /= np.linalg.norm(away)
        share = rng.choice([0.0, rng.uniform()])  # of the way to the shoulder
        place = centre + share * (SHOULDER - centre) + rng.uniform(0.15, 0.5) * away
        size = np.exp(rng.uniform(np.log(0.03), np.log(0.2), size=3))
        turn = rng.normal(size=4)
        turn /= np.linalg.norm(turn)
        kind = "box" if rng.random() < 0.5 else "cylinder"
        extent = size if kind == "box" else np.array([size[0], size[0], size[1]])
        within = np.abs((points - place) @ mink.SO3(turn).as_matrix()) - extent
        if np.linalg.norm(np.maximum(within, 0.0), axis=1).min() < FREE_OF:
            continue
        if np.hypot(place[0], place[1]) < COLUMN + np.linalg.norm(extent):
            continue
        number += 1
        body = spec.worldbody.add_body(name=f"obstacle_{number}", pos=place, quat=turn)
        body.add_geom(name=f"obstacle_{number}", type=kind_of(kind), size=size, **COLLIDES)


def cell(seed: int, every: int) -> qt.PathTask:
    """A random cell: the path, its clearance, and the largest joint step as a speed limit."""
    rng = np.random.default_rng([seed, 11])
    plain = qt.load_task("deburring")
    standing = draw_sample(plain, ("placement",), seed).path_task
    spec = mujoco.MjSpec.from_file(str(plain.scene))
    add_links(spec)
    add_obstacles(spec, standing, rng, int(rng.integers(1, 7)))
    model = spec.compile()
    part = standing.model.body("part").id
    model.body_pos[part], model.body_quat[part] = (
        standing.model.body_pos[part], standing.model.body_quat[part],
    )  # fmt: skip
    clearance = qt.Clearance(model, distance=CLEAR)
    if len(clearance.pairs) < 40:
        raise RuntimeError(f"the cell has {len(clearance.pairs)} pairs: nothing to keep clear of")
    return kept_clear(standing, clearance, every)


def kept_clear(task: qt.PathTask, clearance: qt.Clearance, every: int) -> qt.PathTask:
    """The path at every n-th waypoint, in the cell of a clearance."""
    model, waypoints = clearance.model, task.waypoints[::every]
    return dataclasses.replace(
        task, model=model, waypoints=waypoints, flipped_waypoints=None, best_start=True,
        durations=np.concatenate([[0.0], np.ones(len(waypoints) - 1)]),
        velocity_limits=np.full(model.nv, STEP), acceleration_limits=np.full(model.nv, np.inf),
        constraints=(clearance,),
    )  # fmt: skip


# ---------------------------------------------------------------- the exhaustive search


class Obstacles:
    """Which configurations keep the distance, by coal, where bounds of it do not say so."""

    def __init__(self, model: mujoco.MjModel, pairs: npt.NDArray[np.intp]) -> None:
        self.model, self.pairs, self.oracle = model, pairs, Distances(model)
        self.planes = model.geom_type == mujoco.mjtGeom.mjGEOM_PLANE
        self.balls = np.where(self.planes, np.inf, model.geom_rbound)
        self.centres, self.boxes = model.geom_aabb[:, :3], model.geom_aabb[:, 3:]
        self.last = 0

    def at(self, q: Array, obstacle: Array | None = None) -> Distances:
        """The distances with the robot at q (nq,), and the mocap body at a place (3,)."""
        if obstacle is not None:
            self.oracle.data.mocap_pos[0] = obstacle
        return self.oracle.at(q)

    def bounds(self, q: Array, enough: float, obstacles: Array | None = None) -> Array:
        """Lower bounds of the distances at configurations q (N, nq), m, (N, P).

        That of the balls around two geoms; where it is not enough, the ball around one is at least
        as far from the other's box, and a box from a plane.
        """
        places = np.empty((len(q), self.model.ngeom, 3))
        turns = np.empty((len(q), self.model.ngeom, 9))
        for k, row in enumerate(q):
            data = self.at(row, None if obstacles is None else obstacles[k]).data
            places[k], turns[k] = data.geom_xpos, data.geom_xmat
        R = turns.reshape(*places.shape, 3)
        centres = places + np.einsum("ngij,gj->ngi", R, self.centres)
        away = centres[:, self.pairs[:, 0]] - centres[:, self.pairs[:, 1]]
        least = np.sqrt(np.einsum("npi,npi->np", away, away)) - self.balls[self.pairs].sum(axis=1)
        k, near = np.nonzero(least < enough)
        for one, other in (self.pairs[near].T, self.pairs[near].T[::-1]):
            apart = np.einsum("nij,ni->nj", R[k, other], centres[k, one] - places[k, other])
            outside = np.maximum(np.abs(apart - self.centres[other]) - self.boxes[other], 0.0)
            bound = np.sqrt(np.einsum("ni,ni->n", outside, outside)) - self.balls[one]
            above = np.abs(np.einsum("nij,ni->nj", R[k, one], R[k, other][..., 2]))
            reach = np.einsum("nj,nj->n", above, self.boxes[one])
            bound = np.where(self.planes[other], apart[:, 2] - reach, bound)
            least[k, near] = np.maximum(least[k, near], bound)
        return least

    def keeps(self, q: Array, distance: float = CLEAR) -> npt.NDArray[np.bool_]:
        """Which configurations q (N, nq) have all pairs at least so far apart, (N,)."""
        kept = np.ones(len(q), dtype=bool)
        near = self.bounds(q, distance) < distance
        for k in np.flatnonzero(near.any(axis=1)):
            self.oracle.at(q[k])
            pairs = np.flatnonzero(near[k])
            if near[k, self.last]:  # what was too near before is so again more often than not
                pairs = np.append(self.last, pairs[pairs != self.last])
            for pair in pairs:
                a, b = (int(geom) for geom in self.pairs[pair])
                plane = self.planes[a] or self.planes[b]
                if (self.oracle if plane else self.oracle.by_coal)(a, b).value < distance:
                    self.last, kept[k] = int(pair), False
                    break
        return kept

    def least(self, q: Array, obstacles: Array | None = None) -> float:
        """The least distance of all pairs along motions q (N, nq), m; at most 0.2.

        With the mocap body at places (N, 3), if there is one.
        """
        found = 0.2
        bounds = self.bounds(q, found, obstacles)
        for k in np.argsort(bounds.min(axis=1)):  # the nearest first leave little to look at
            near = self.pairs[bounds[k] < found]
            if not len(near):
                break
            there = self.at(q[k], None if obstacles is None else obstacles[k])
            found = min(found, there.of(near).min())
        return float(found)


class Layer(NamedTuple):
    """In-limit configurations of a waypoint, (K, nv), with and without the distance."""

    q: Array
    z: Array
    """∞ for those known to be too near, (K,)."""
    base: Array
    """Those that differ by more than full turns, (B, nv)."""
    of: npt.NDArray[np.intp]
    """Row of ``base`` of each of q, (K,)."""


class Search:
    """All motions through a cell on a grid of rolls.

    Of the layers on the best motion those configurations that it takes are looked at first; where
    one is too near, all of that waypoint.
    """

    def __init__(self, task: qt.PathTask, roll_step: float) -> None:
        self.task, self.arm = task, InverseKinematics(task)
        self.ranges = qt.JointRanges.of(task.model)
        clearance = next(c for c in task.constraints if isinstance(c, qt.Clearance))
        self.obstacles = Obstacles(task.model, clearance.pairs)
        rolls = np.radians(np.arange(0.0, 360.0, roll_step))
        self.layers = [self._layer(pose, rolls) for pose in task.waypoints]
        self.looked_at: set[int] = set()
        #: Links from each layer to the next, in the order of their ends: rows of the first, (L,);
        #: where those that end at each row of the second begin; ∞ for those left out, else 0, (L,).
        self.links = [self._links(*two) for two in itertools.pairwise(self.layers)]

    def _layer(self, pose: mink.SE3, rolls: Array) -> Layer:
        q = self.arm.layer(pose, rolls, 8)
        turned = np.round(self.arm.centred(q), 9)
        _, first, of = np.unique(turned, axis=0, return_index=True, return_inverse=True)
        return Layer(q, self.ranges.centering(q), q[first], of.ravel())

    @staticmethod
    def _links(before: Layer, after: Layer) -> tuple[Array, Array, Array]:
        if not len(before.q) or not len(after.q):
            none = np.zeros(0, dtype=np.intp)
            return none, np.zeros(len(after.q) + 1, dtype=np.intp), np.zeros(0)
        pairs = cKDTree(before.q).sparse_distance_matrix(
            cKDTree(after.q), STEP, p=np.inf, output_type="ndarray"
        )
        order = np.argsort(pairs["j"], kind="stable")
        i, j = pairs["i"][order], pairs["j"][order]
        return i, np.searchsorted(j, np.arange(len(after.q) + 1)), np.zeros(len(i))

    def clear(self, k: int) -> npt.NDArray[np.bool_]:
        """Which configurations of layer k keep the distance, (K,)."""
        layer = self.layers[k]
        if k not in self.looked_at:
            self.looked_at.add(k)
            layer.z[~self.obstacles.keeps(layer.base)[layer.of]] = np.inf
        return np.isfinite(layer.z)

    @property
    def in_the_way(self) -> bool:
        """Whether a configuration that was looked at is too near."""
        return any(np.isinf(layer.z).any() for layer in self.layers)

    def best(self, *, between: bool) -> tuple[Array | None, int]:
        """The motion of least mean z and the first waypoint that none gets to, from 1.

        With ``between``, connections of the best motion that come too near are left out until none
        does; if that takes too long, or there is no such motion, there is none.
        """
        costs: list[Array] = []
        known: list[dict[tuple[int, int], bool]] = [{} for _ in self.links]
        trials = 0
        while trials < TRIALS:
            path, end = self._shortest(costs)
            if path is None:
                return None, end
            q = np.array([layer.q[row] for layer, row in zip(self.layers, path, strict=True)])
            near = [int(k) for k in np.flatnonzero(~self.obstacles.keeps(q))]
            for k in near:
                self.clear(k)
            if near:
                del costs[near[0] :]
                continue
            if not between:
                return q, 0
            bad = self._too_near(q, path, known)
            if not bad:
                return q, 0
            trials += 1
            for k in bad:
                i, begins, left_out = self.links[k]
                of_end = slice(begins[path[k + 1]], begins[path[k + 1] + 1])
                left_out[of_end][i[of_end] == path[k]] = np.inf
            del costs[bad[0] + 1 :]
        return None, 0

    def _too_near(
        self, q: Array, path: npt.NDArray[np.intp], known: list[dict[tuple[int, int], bool]]
    ) -> list[int]:
        """Connections of a motion q (N, nv) that come nearer than the distance."""
        new = [k for k, of in enumerate(known) if (int(path[k]), int(path[k + 1])) not in of]
        shares = np.arange(1, INSIDE + 1)[:, None] / (INSIDE + 1)
        points = [q[k] + shares * (q[k + 1] - q[k]) for k in new]
        if new:
            kept = self.obstacles.keeps(np.concatenate(points)).reshape(len(new), -1).all(axis=1)
            for k, keeps in zip(new, kept, strict=True):
                known[k][int(path[k]), int(path[k + 1])] = bool(keeps)
        return [k for k, of in enumerate(known) if not of[int(path[k]), int(path[k + 1])]]

    def _shortest(self, costs: list[Array]) -> tuple[npt.NDArray[np.intp] | None, int]:
        """Rows of the layers along the way of least sum of z, and where ways end.

        ``costs`` has the sums of the layers up to the first that changed since, and gets the rest.
        """
        if not costs:
            costs.append(self.layers[0].z.copy())
        for k in range(len(costs) - 1, len(self.layers) - 1):
            if not np.isfinite(costs[k]).any():
                return None, k + 1
            i, begins, left_out = self.links[k]
            sums = np.full(len(begins) - 1, np.inf)
            some = np.diff(begins) > 0
            if some.any():
                sums[some] = np.minimum.reduceat(costs[k][i] + left_out, begins[:-1][some])
            costs.append(sums + self.layers[k + 1].z)
        if not np.isfinite(costs[-1]).any():
            return None, len(self.layers)
        path = [int(np.argmin(costs[-1]))]
        for k in range(len(self.links) - 1, -1, -1):
            i, begins, left_out = self.links[k]
            of_end = slice(begins[path[-1]], begins[path[-1] + 1])
            path.append(int(i[of_end][np.argmin(costs[k][i[of_end]] + left_out[of_end])]))
        return np.array(path[::-1]), 0


# ---------------------------------------------------------------- a cell


def one_cell(seed: int, every: int, roll_step: float) -> dict[str, Any]:
    """A plan and the search in a cell, and what contradicts what."""
    task = cell(seed, every)
    began = time.perf_counter()
    try:
        plan = qt.plan(task)
    except Exception as error:  # is a fault of its own, and no reason to lose the other cells
        wrong = [f"{type(error).__name__}: {error}"]
        return {"cell": seed, "planned": False, "at_waypoints": None, "between": None,
                "in_the_way": None, "seconds": np.nan, "z": None, "wrong": wrong}  # fmt: skip
    planned = time.perf_counter() - began
    began = time.perf_counter()
    search = Search(task, roll_step)
    loose, end = search.best(between=False)
    strict, _ = search.best(between=True) if loose is not None else (None, 0)
    found: dict[str, Any] = {
        "cell": seed, "obstacles": sum("obstacle" in task.model.body(b).name
                                       for b in range(task.model.nbody)),
        "planned": plan.q is not None, "seconds": round(planned, 2),
        "search_seconds": round(time.perf_counter() - began, 1),
        "at_waypoints": loose is not None, "between": strict is not None,
        "in_the_way": search.in_the_way,
        "search_ends_at": end, "certificate": str(plan.certificate),
        "kind": plan.certificate.kind,
    }  # fmt: skip
    for name, motion in (("z_loose", loose), ("z_strict", strict), ("z", plan.q)):
        found[name] = None if motion is None else float(search.ranges.centering(motion).mean())
    wrong = contradictions(plan, search, loose)
    if plan.q is not None:
        at = search.obstacles.least(plan.q)
        shares = np.arange(1, INSIDE + 1) / (INSIDE + 1)
        steps = np.diff(plan.q, axis=0)
        inside = (plan.q[:-1, None] + shares[:, None] * steps[:, None]).reshape(-1, task.model.nq)
        between = search.obstacles.least(inside)
        found |= {"least_mm": 1e3 * at, "least_between_mm": 1e3 * between}
        wrong += [f"{1e3 * at:.6f} mm at a waypoint"] * (at < CLEAR - 1e-6)
        wrong += [f"{1e3 * between:.4f} mm between waypoints"] * (between < CLEAR - BETWEEN - 1e-6)
        wrong += faults(task, plan.q)
    elif strict is not None:
        wrong.append("not planned")
    return {**found, "wrong": wrong}


def contradictions(plan: qt.Plan, search: Search, loose: Array | None) -> list[str]:
    """What a certificate claims as proven and the search refutes."""
    certificate = plan.certificate
    if plan.q is not None or certificate.detail or not certificate.covered:
        return []
    if certificate.kind == "speed":
        return [] if loose is None else ["certificate: a connection exists"]
    wrong = []
    for waypoint in certificate.waypoints:
        of_limits = certificate.kind != "band"
        refuted = len(search.layers[waypoint - 1].q) if of_limits else search.clear(waypoint - 1)
        if np.any(refuted):
            wrong.append(f"certificate: there is a configuration at waypoint {waypoint}")
    return wrong


def faults(task: qt.PathTask, q: Array) -> list[str]:
    """Joint ranges, steps and the path itself, by MuJoCo's kinematics."""
    wrong = []
    lower, upper = task.model.jnt_range.T
    if (q < lower - 1e-9).any() or (q > upper + 1e-9).any():
        wrong.append("joint range")
    if np.abs(np.diff(q, axis=0)).max() > STEP + 1e-9:
        wrong.append("joint step")
    data = mujoco.MjData(task.model)
    for row, waypoint in zip(q, task.waypoints, strict=True):
        data.qpos[:] = row
        mujoco.mj_kinematics(task.model, data)
        site = data.site(task.frame_name)
        away = np.linalg.norm(site.xpos - waypoint.translation())
        turned = np.linalg.norm(site.xmat[2::3] - waypoint.rotation().as_matrix()[:, 2])
        if away > 1e-6 or turned > 1e-6:
            wrong.append(f"off the path by {1e3 * away:.1e} mm, {turned:.1e}")
            break
    return wrong


def random_cells(cells: int, first: int, every: int, roll_step: float, jobs: int, keep: str) -> Any:
    """Plans beside the search."""
    found, seeds = [], range(first, first + cells)
    for row in each(one_cell, seeds, jobs, keep, every=every, roll_step=roll_step):
        print(json.dumps(row), file=sys.stderr, flush=True)
        found.append(row)
    verdicts = Counter((row["at_waypoints"], row["between"], row["planned"]) for row in found)
    say = {None: "", False: "–", True: "yes"}
    rows = [(*(say[v] for v in key), count) for key, count in sorted(verdicts.items(), key=str)]
    head = ("search, at waypoints", "search, between them, too", "planned", "cells")
    text = [markdown_table(head, rows, left=3)]
    for name, key in (("between", "z_strict"), ("waypoints alone", "z_loose")):
        shares = [row["z"] / row[key] for row in found if row["planned"] and row[key]]
        if shares:
            middle, most, worst = np.percentile(shares, [50, 90, 100])
            text.append(
                f"Mean z over the search's ({name}), {len(shares)} cells: median {middle:.4f}, "
                f"90 % {most:.4f}, largest {worst:.4f}.\n"
            )
    planned = [row for row in found if row["planned"]]
    if planned:
        at, between = (min(r[k] for r in planned) for k in ("least_mm", "least_between_mm"))
        text.append(f"Least clearance {at:.6f} mm at waypoints, {between:.4f} mm between.\n")
    seconds = [row["seconds"] for row in found]
    text.append(
        f"In {sum(bool(row['in_the_way']) for row in found)} of {len(found)} cells an obstacle is "
        "in the way of the grid's best motion. A plan takes "
        f"{np.nanmedian(seconds):.2f} s in the median, {np.nanmax(seconds):.2f} s at most.\n"
    )
    wrong = [(row["cell"], "; ".join(row["wrong"])) for row in found if row["wrong"]]
    if wrong:
        text.append(markdown_table(("cell", "wrong"), wrong, left=2))
    return "\n".join(text), len(wrong)


# ---------------------------------------------------------------- what obstacles cost a plan


def crowded(seed: int, number: int) -> qt.PathTask:
    """The deburring path, 401 waypoints, among so many obstacles."""
    plain = qt.load_task("deburring")
    spec = mujoco.MjSpec.from_file(str(plain.scene))
    add_links(spec)
    add_obstacles(spec, plain, np.random.default_rng([seed, 7]), number)
    return kept_clear(plain, qt.Clearance(spec.compile(), distance=CLEAR), 1)


def one_crowded(seed: int) -> tuple[object, ...]:
    """Processor seconds of a plan among ten obstacles, and without clearance, with what is found.

    Both are planned once before, so that nothing is compiled or loaded.
    """
    task = crowded(seed, OBSTACLES)
    empty = dataclasses.replace(task, constraints=(task.constraints[0].without_pairs(),))  # type: ignore[attr-defined]
    for warm in (task, empty):
        few = dataclasses.replace(warm, waypoints=warm.waypoints[:8], durations=warm.durations[:8])
        qt.plan(few)
    times = []
    for _ in range(REPEATED):
        began = time.process_time()
        free = qt.plan(empty)
        between = time.process_time()
        plan = qt.plan(task)
        times.append((time.process_time() - between, between - began))
    blocked = task.constraints[0].margins(free.q).min() < 0.0
    return seed, blocked, plan.value, free.value, *np.median(times, axis=0), plan.certificate.kind


def crowded_cells(cells: int, first: int, jobs: int) -> str:
    """Processor time of plans among ten obstacles over that without any."""
    rows = []
    for row in in_processes(one_crowded, range(first, first + cells), jobs):
        print(*row, file=sys.stderr, flush=True)
        rows.append(row)
    text = []
    for what, of in (
        ("the best path is clear", [r for r in rows if r[-1] == "path" and not r[1]]),
        ("the best path is blocked, another found", [r for r in rows if r[-1] == "path" and r[1]]),
        ("no plan", [r for r in rows if r[-1] != "path"]),
    ):
        if of:
            shares = np.array([float(r[4]) / float(r[5]) for r in of])  # type: ignore[arg-type]
            seconds = np.median([float(r[4]) for r in of])  # type: ignore[arg-type]
            numbers = (f"{v:.2f}" for v in np.percentile(shares, [0, 50, 90, 100]))
            most = f"{(shares <= 2.0).sum()} of {len(of)}"
            text.append((what, len(of), f"{seconds:.1f}", *numbers, most))
    head = ("", "cells", "plan, s", "ratio, least", "median", "90 %", "largest", "at most 2")
    return markdown_table(head, text)


# ---------------------------------------------------------------- steps in front of walls

DT = 0.005
FASTEST, HARDEST = 0.5 * np.pi, 10.0
FLIP, MANY = 0.3, 5
"""Speed above which a change of sign counts, rad/s; sign changes of a run that count as chatter."""
ASKED = 0.01
"""Distance that steps keep, m."""
ASKED_OF_MINK = 0.02
"""Distance that mink's limit has to be asked for to keep as much, m: with its default gain it comes
up to 5 mm nearer than asked."""
LENGTH = 4.0
"""Length of a run, s."""
REPORTED = 1e-6
"""A clearance that is less by more is reported, m."""
SWING = 0.4
"""Amplitude of the obstacle, m."""
BESIDE = 5
"""Number of starts from which mink's steps are counted, too."""
WORLDS = ("wall", "corner", "moving")
SETTINGS = [(mode, limit) for limit in (None, HARDEST) for mode in ("scale", "relax")]


def before(world: str) -> mujoco.MjModel:
    """An arm of seven axes made of capsules, on a floor, and what is in its way."""
    wall = '<geom name="wall" type="box" size="0.1 1 1" pos="0.55 0 0"/>'
    ways = {
        "wall": wall,
        "corner": f'{wall}<geom name="side" type="plane" size="1 1 1" pos="0 0.35 0" '
        'zaxis="0 -1 0"/>',
        "moving": '<body name="obstacle" mocap="true"><geom name="ball" size="0.1"/>'
        '<geom name="block" type="box" size="0.05 0.12 0.03" pos="0 0 0.1"/></body>',
    }
    capsule = '<geom type="capsule" size="{radius}" fromto="0 0 0 0 0 {top}"/>'
    return seven_axes(capsule, f'<geom name="floor" type="plane" size="1 1 1"/>{ways[world]}')


class Way(NamedTuple):
    """A run: where it starts, where the target is, and where the obstacle."""

    world: str
    model: mujoco.MjModel
    start: Array
    home: mink.SE3
    """Pose of the tool at the start."""
    beyond: Array
    """Where the target is drawn to, m, (3,)."""
    along: Array
    """Direction in which the target or the obstacle swings, m, (3,)."""

    def target(self, t: float) -> mink.SE3:
        """Where the tool should be."""
        if self.world == "moving":
            return self.home
        place = self.home.translation()
        share = min(t, 1.0)
        place = place + share * (self.beyond - place) + 0.2 * np.sin(3.0 * t) * self.along
        return mink.SE3.from_rotation_and_translation(self.home.rotation(), place)

    def obstacle(self, t: float) -> Array:
        """Where the obstacle is, m, (3,): it passes the tool's place at up to 0.3 m/s."""
        return self.home.translation() + SWING * np.cos(np.pi / LENGTH * t) * self.along


def way(world: str, seed: int) -> Way:
    """A random run in a world; the arm starts inside its ranges and 50 mm clear of everything."""
    model = before(world)
    rng = np.random.default_rng([seed, WORLDS.index(world)])
    lower, upper = 0.8 * model.jnt_range.T
    beyond = np.array([0.6, rng.uniform(-0.4, 0.6), rng.uniform(0.2, 0.8)])
    judge = Obstacles(model, limits(model)[0].pairs)
    while True:
        start, along = rng.uniform(lower, upper), rng.normal(size=3)
        home = mink.Configuration(model, start).get_transform_frame_to_world("tool", "site")
        made = Way(world, model, start, home, beyond, along / np.linalg.norm(along))
        if model.nmocap:
            passed = np.array([made.obstacle(t) for t in np.linspace(0.0, LENGTH, 50)])
            # Not through the floor nor through the shoulder, which cannot give way.
            if np.hypot(*passed[:, :2].T).min() < 0.4 or passed[:, 2].min() < 0.3:
                continue
            judge.oracle.data.mocap_pos[0] = passed[0]
        if judge.keeps(start[None], 0.05)[0]:
            return made


def limits(model: mujoco.MjModel, acceleration: float | None = None) -> list[Any]:
    """Clearance and motion limits of the controller; the last two links are always near."""
    clearance = qt.Clearance(model, distance=ASKED, ignore=[("link_5", "link_7")])
    hardest = "default" if acceleration is None else acceleration
    return [clearance, qt.MotionLimit(model, velocity=FASTEST, acceleration=hardest)]


def ours(made: Way, mode: str, acceleration: float | None) -> Any:
    """A step of the controller."""
    task = qt.TwistTask.axis_free("tool", "site")
    controller = qt.Controller(
        made.model, [task], limits=limits(made.model, acceleration), on_infeasible=mode,  # type: ignore[arg-type]
        secondary=[qt.PostureReference(made.model, made.start, gain=0.01)],
    )  # fmt: skip

    def step(configuration: mink.Configuration, target: mink.SE3) -> Array:
        task.set_target(target)
        return controller.step(configuration, DT).velocity

    return step


def minks(made: Way, asked: float = ASKED) -> Any:
    """A step of mink with its collision limit on the same pairs.

    Less those of the world with the body that is jointed to it, which it leaves out.
    """
    model = made.model
    pairs = [([int(a)], [int(b)]) for a, b in limits(model)[0].pairs]
    collisions = mink.CollisionAvoidanceLimit(
        model, pairs, minimum_distance_from_collisions=asked, collision_detection_distance=0.1
    )
    speeds = {model.joint(i).name: FASTEST for i in range(model.njnt)}
    task = mink.FrameTask("tool", "site", 1.0, 1.0, lm_damping=1.0)
    posture = mink.PostureTask(model, 1e-2)
    posture.set_target(made.start)
    bounds = [mink.ConfigurationLimit(model), mink.VelocityLimit(model, speeds), collisions]

    def step(configuration: mink.Configuration, target: mink.SE3) -> Array:
        task.set_target(target)
        return mink.solve_ik(configuration, [task, posture], DT, "daqp", 1e-3, limits=bounds)

    return step


class Passage(NamedTuple):
    """What a run shows."""

    short: float
    """By how much the clearance is less than asked at most, m."""
    flips: int
    excess: float
    """Over position, velocity and acceleration limits."""
    failures: int
    states: Any


def run(made: Way, step: Any, acceleration: float | None) -> Passage:
    """Follow the target; clearances are looked at after each step, where the obstacle is then."""
    configuration = mink.Configuration(made.model, made.start.copy())
    judge = Obstacles(made.model, limits(made.model)[0].pairs)
    lower, upper = made.model.jnt_range.T
    velocities, states, failures, excess = [np.zeros(7)], [], 0, 0.0
    times = DT * np.arange(round(LENGTH / DT) + 1)
    places = np.array([made.obstacle(t) for t in times]) if made.model.nmocap else None
    for k in range(round(LENGTH / DT)):
        if places is not None:
            configuration.data.mocap_pos[0] = places[k]
            configuration.update()
        states.append(configuration.q.copy())
        try:
            velocity = step(configuration, made.target(k * DT))
        except Exception:
            velocity, failures = np.zeros(7), failures + 1
        configuration.integrate_inplace(velocity, DT)
        q = configuration.q
        excess = max(excess, (q - upper).max(), (lower - q).max(), np.abs(velocity).max() - FASTEST)
        if acceleration is not None:
            excess = max(excess, np.abs(velocity - velocities[-1]).max() - acceleration * DT)
        velocities.append(velocity)
    after = np.array([*states[1:], configuration.q])
    least = judge.least(after, None if places is None else places[1:])
    v = np.array(velocities)
    fast = (v[1:] * v[:-1] < 0.0) & (np.minimum(np.abs(v[1:]), np.abs(v[:-1])) > FLIP)
    return Passage(ASKED - least, int(fast.sum()), float(excess), failures, np.array(states))


def one_start(task: tuple[str, int], beside: bool) -> dict[str, Any]:
    """What the runs from one start in a world show, by mode and acceleration limit."""
    made, found = way(*task), {}
    for mode, limit in [("mink", None)] * beside + SETTINGS:
        step = minks(made) if mode == "mink" else ours(made, mode, limit)
        passage = run(made, step, limit)._asdict()
        del passage["states"]
        found[f"{mode} {limit}"] = passage
    return found


def walls(runs: int, first: int, jobs: int, keep: str) -> tuple[str, int]:
    """Least clearance, sign changes and violated limits in front of walls and obstacles."""
    rows, wrong, seeds = [], [], range(first, first + runs)
    for world in WORLDS:
        of_mink = each(one_start, [(world, s) for s in seeds[:BESIDE]], jobs, keep, beside=True)
        others = each(one_start, [(world, s) for s in seeds[BESIDE:]], jobs, keep, beside=False)
        starts = dict(zip(seeds, itertools.chain(of_mink, others), strict=True))
        for mode, limit in [("mink", None), *SETTINGS]:
            name = f"{mode} {limit}"
            found = {
                seed: Passage(**p[name], states=None) for seed, p in starts.items() if name in p
            }
            for seed, passage in found.items() if mode != "mink" else ():
                at = f"{world} {seed}, {mode}, a = {limit}"
                if passage.short > REPORTED:
                    wrong.append((at, f"{1e3 * passage.short:.4f} mm nearer than asked"))
                if passage.excess > 1e-9 or passage.failures:
                    said = f"excess {passage.excess:.0e}, {passage.failures} exceptions"
                    wrong.append((at, said))
            every = found.values()
            rows.append(
                (world, mode, "" if limit is None else f"{limit:g}", len(found),
                 f"{1e3 * max(*(p.short for p in every), 0.0):.3g}",
                 sum(p.short > REPORTED for p in every), max(p.flips for p in every),
                 sum(p.flips > MANY for p in every),
                 f"{max(*(p.excess for p in every), 0.0):.0e}", sum(p.failures for p in every))
            )  # fmt: skip
    head = ("world", "mode", "a", "runs", "nearer than asked by at most, mm", "runs that are",
            "sign changes at most", f"runs with more than {MANY}", "excess",
            "exceptions")  # fmt: skip
    text = markdown_table(head, rows, left=2)
    if wrong:
        text += "\n" + markdown_table(("run", "wrong"), wrong, left=2)
    return text, len(wrong)


def wall_times(first: int, blocks: int) -> str:
    """Median times of steps in front of walls, and their ratio, largest block first."""
    rows = []
    for world, limit in itertools.product(WORLDS, (None, HARDEST)):
        for stopped in (True, False):
            task = "does not fit" if stopped else "fits"
            of_steps = step_times(way(world, first), blocks, limit, stopped=stopped)
            rows.append((world, "" if limit is None else f"{limit:g}", task, *of_steps))
    head = ("world", "a", "task", "pairs", "controller µs", "mink µs", "ratio, largest", "90 %",
            "median", "10 %")  # fmt: skip
    return markdown_table(head, rows, left=3)


def step_times(made: Way, blocks: int, limit: float | None, *, stopped: bool) -> tuple[object, ...]:
    """Median times of steps at the configurations of a run, µs, and ratios of the blocks.

    ``limit`` is the controller's acceleration limit, rad/s²; mink has none.

    The target is that of the run, most of it behind the wall, or where the next step leads. What
    places the robot and the obstacle is not timed; what sets the target is.
    """
    states = run(made, ours(made, "scale", limit), limit).states
    targets = [made.target(k * DT) for k in range(len(states))]
    if not stopped:
        configuration = mink.Configuration(made.model)
        for k, q in enumerate(states[1:]):
            configuration.update(q)
            targets[k] = configuration.get_transform_frame_to_world("tool", "site")
    steps = {}
    minks_ = minks(made, ASKED_OF_MINK)
    for name, step in (("ours", ours(made, "scale", limit)), ("mink", minks_)):
        configuration = mink.Configuration(made.model)

        def before(k: int, configuration: Any = configuration) -> tuple[Any, mink.SE3]:
            if made.model.nmocap:
                configuration.data.mocap_pos[0] = made.obstacle(k * DT)
            configuration.update(states[k])
            return configuration, targets[k]

        def call(arguments: tuple[Any, mink.SE3], step: Any = step) -> Array:
            velocity: Array = step(*arguments)
            return velocity

        steps[name] = SplitStep(before, call)
        steps[name](0)
    starts = np.linspace(LEAD_IN, len(states) - 1 - len(states) // 4, blocks).astype(int)
    sections = [range(k, k + len(states) // 4) for k in starts.tolist()]
    timed = interleaved(steps, sections, np.random.default_rng(0))
    ours_, minks_ = (
        np.median(np.reshape(timed[name].call, (blocks, -1)), axis=1) for name in ("ours", "mink")
    )
    ratios = np.percentile(ours_ / minks_, [100, 90, 50, 10])
    middle = [f"{1e-3 * float(np.median(timed[name].call)):.0f}" for name in steps]
    return len(limits(made.model)[0].pairs), *middle, *(f"{share:.2f}" for share in ratios)


PARTS = {f.__name__: f for f in (random_cells, crowded_cells, walls, wall_times)}
OPTIONS: dict[str, Any] = {
    "keep": "", "cells": 20, "first": 0, "every": 10, "roll_step": 2.0, "jobs": 1, "runs": 5,
    "blocks": 12,
}  # fmt: skip

if __name__ == "__main__":
    raise SystemExit(command(__doc__, PARTS, **OPTIONS))
