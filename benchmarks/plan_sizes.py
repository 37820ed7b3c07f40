"""What plans of long paths and large cells take.

    python benchmarks/plan_sizes.py [plan_waypoints] [--write]
    python benchmarks/plan_sizes.py [plan_sizes] [--write]

*plan_waypoints*: the deburring run at 101 to 6,401 waypoints, no joint moving more than 15° to the
next one; beside, a plain dynamic program over every waypoint (``least_mean_z`` of plans.py, with
the inverse kinematics of placements.py; rolls 4° apart, all branches and turns).

*plan_sizes*: 437 waypoints for an arm of seven joints and a part on a table that turns and tilts,
four degrees free, with clearance; with two free degrees, and a step that no motion makes; 6,401
waypoints of the arm on a rail; the arm in front of a casting of 20,480 triangles, whose hull
stands for it, and among 100 obstacles.

Each is made by a process of its own, which reports its processor time, and how much its peak of
memory is above that before. Machine code is loaded before. Twenty minutes,
of which the plain program takes half.
"""

from page import command, in_processes, markdown_table

# isort: split
import dataclasses
import resource
import sys
import time
from collections.abc import Callable

import mink
import mujoco
import numpy as np
import trimesh
from cells import CLEAR, add_links, crowded, kept_clear
from plans import SEVEN, deburring, least_mean_z, on_a_rail, seven

import qp_twist as qt
from qp_twist.authoring.solids import convex_pieces

STEP = 15.0
"""Largest step of a joint, degrees."""
WAYPOINTS = (101, 201, 401, 801, 1601, 3201, 6401)
ROLL = 4.0
"""Of the plain program, degrees; the first grid of a plan has it, too."""


def resampled(task: qt.PathTask, count: int) -> qt.PathTask:
    """The path at so many waypoints, evenly between its own."""
    path = task.at(np.linspace(0.0, len(task.waypoints) - 1.0, count))
    waypoints = tuple(
        mink.SE3.from_rotation_and_translation(mink.SO3.from_matrix(R), p)
        for R, p in zip(path.rotations, path.positions, strict=True)
    )
    return dataclasses.replace(task, waypoints=waypoints, flipped_waypoints=None, durations=None)


def measured(make: Callable[[], float]) -> tuple[float, float, float]:
    """Processor seconds, memory, MB, and the value."""
    before, cpu = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss, time.process_time()
    value = make()
    cpu = time.process_time() - cpu
    memory = (resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before) / 1024.0
    return cpu, memory, value


def of_plan(count: int) -> tuple[float, float, float]:
    """A plan of so many waypoints."""
    qt.plan(deburring(10), max_step_deg=STEP)
    task = resampled(deburring(1), count)
    return measured(lambda: qt.plan(task, max_step_deg=STEP).value)


def of_program(count: int) -> tuple[float, float, float]:
    """The plain dynamic program."""
    task = resampled(deburring(1), count)
    return measured(lambda: least_mean_z(task, ROLL))


def plan_waypoints() -> str:
    """A row for each number of waypoints."""
    rows = []
    for count in WAYPOINTS:
        cells = [f"{count:,}"]
        for work in (of_plan, of_program):
            [(cpu, memory, value)] = in_processes(work, [count], 1)
            cells += [f"{cpu:.1f}", f"{memory:.0f}", f"{value:.4f}"]
        rows.append(cells)
        print(*cells, file=sys.stderr, flush=True)
    headings = ("waypoints", "plan, s", "MB", "mean z", "plain program, s", "MB", "mean z")
    return markdown_table(headings, rows)


# ---------------------------------------------------------------- large cells

COUNT = 437
FENCE = 0.45
"""Radius of the fence, m."""
HOVER = 0.07
"""Of the tool's point above the plate, m: its link is a capsule that ends 40 mm further."""


def on_two_more_axes() -> qt.PathTask:
    """The arm of seven joints, a circle above the plate of a turn-tilt table, posts beside it."""
    spec = mujoco.MjSpec.from_string(SEVEN)
    frame = spec.worldbody.add_body(name="frame", pos=[0.55, 0.0, 0.15])
    plate = frame.add_body(name="plate")
    for body, name, axis, most in (
        (frame, "tilt", [0, 1, 0], 1.0),
        (plate, "turn", [0, 0, 1], 3.0),
    ):
        body.add_joint(name=name, axis=axis, range=[-most, most], limited=1)
        body.mass, body.inertia, body.explicitinertial = 1.0, np.ones(3), 1
    plate.add_geom(name="plate", type=mujoco.mjtGeom.mjGEOM_BOX, size=[0.12, 0.12, 0.02])
    for number, y in enumerate((-0.35, 0.35)):
        spec.worldbody.add_geom(
            name=f"post {number}", type=mujoco.mjtGeom.mjGEOM_CYLINDER, size=[0.04, 0.4, 0.0],
            pos=[0.4, y, 0.4],
        )  # fmt: skip
    model, down = spec.compile(), mink.SO3.from_x_radians(np.pi)
    angles = np.linspace(-np.pi, np.pi, COUNT)
    circle = np.column_stack([0.08 * np.cos(angles), 0.08 * np.sin(angles), np.full(COUNT, HOVER)])
    none = np.full(9, np.inf)
    return dataclasses.replace(
        seven(3), name="seven and two", model=model, start=np.zeros(9), relative_to="plate",
        waypoints=tuple(
            mink.SE3.from_rotation_and_translation(down, point)
            for point in circle
        ),
        velocity_limits=none, acceleration_limits=none, constraints=(qt.Clearance(model, CLEAR),),
    )  # fmt: skip


def turned_at_once() -> qt.PathTask:
    """A line on which the tool turns by 16° once: with steps of 2° seven joints turn it by 14°."""
    task, down = seven(COUNT), mink.SO3.from_x_radians(np.pi)
    return dataclasses.replace(
        task,
        waypoints=tuple(
            mink.SE3.from_rotation_and_translation(
                down @ mink.SO3.from_x_radians(np.radians(16.0 * (share > 0.6))),
                np.array([0.5, 0.16 * share - 0.08, 0.3]),
            )
            for share in np.linspace(0.0, 1.0, COUNT)
        ),
    )


def before_a_casting() -> qt.PathTask:
    """The deburring run beside a lobed casting of 20,480 triangles."""
    plain = qt.load_task("deburring")
    mesh = trimesh.creation.icosphere(subdivisions=5, radius=0.2)
    around = np.arctan2(mesh.vertices[:, 1], mesh.vertices[:, 0])
    mesh.vertices = mesh.vertices * (1.0 + 0.25 * np.sin(3.0 * around))[:, None]
    spec = mujoco.MjSpec.from_file(str(plain.scene))
    add_links(spec)
    for number, piece in enumerate(convex_pieces("casting", mesh)[0] or (mesh,)):
        name = f"casting {number}"
        spec.add_mesh(name=name, uservert=piece.vertices.ravel(), userface=piece.faces.ravel())
        spec.worldbody.add_geom(
            name=name, type=mujoco.mjtGeom.mjGEOM_MESH, meshname=name, pos=[0.75, 0.9, 0.4],
            contype=1, conaffinity=1,
        )  # fmt: skip
    return kept_clear(plain, qt.Clearance(spec.compile(), distance=CLEAR), 1)


def fenced() -> qt.PathTask:
    """The deburring run with a hundred posts around its part, but for the side of the arm."""
    plain = qt.load_task("deburring")
    middle = plain.positions.mean(axis=0)
    spec = mujoco.MjSpec.from_file(str(plain.scene))
    add_links(spec)
    behind = np.arctan2(middle[1], middle[0])
    for number, angle in enumerate(behind + np.radians(np.linspace(-110.0, 110.0, 100))):
        x, y = middle[:2] + FENCE * np.array([np.cos(angle), np.sin(angle)])
        spec.worldbody.add_geom(
            name=f"post {number}", type=mujoco.mjtGeom.mjGEOM_CYLINDER, size=[0.01, 0.6, 0.0],
            pos=[x, y, 0.6], contype=1, conaffinity=1,
        )  # fmt: skip
    return kept_clear(plain, qt.Clearance(spec.compile(), distance=CLEAR), 1)


CELLS: dict[str, tuple[Callable[[], qt.PathTask], float]] = {
    "7 + 2 axes, four free, clearance, 437 waypoints": (on_two_more_axes, STEP),
    "7 axes, two free, 437 waypoints, steps of 2°, one too long": (turned_at_once, 2.0),
    "6 axes on a rail, two free, 6,401 waypoints": (lambda: resampled(on_a_rail(1), 6401), STEP),
    "6 axes, casting of 20,480 triangles, 401 waypoints": (before_a_casting, STEP),
    "6 axes, fence of 100 posts, 401 waypoints": (fenced, STEP),
    "6 axes, 100 obstacles that enclose the part, 401 waypoints": (lambda: crowded(0, 100), STEP),
}


def of_cell(name: str) -> tuple[int, float, float, float, str]:
    """Number of pairs of geoms, processor seconds, memory, value, and the certificate."""
    make, step = CELLS[name]
    task, found = make(), []
    qt.plan(task.part(slice(0, 3)), max_step_deg=step)

    def value() -> float:
        found.append(qt.plan(task, max_step_deg=step))
        return found[0].value

    pairs = sum(len(clearance.pairs) for clearance in task.clearances)
    return pairs, *measured(value), str(found[0].certificate)


def plan_sizes() -> str:
    """A row for each cell."""
    rows = []
    for name in CELLS:
        [(pairs, cpu, memory, value, certificate)] = in_processes(of_cell, [name], 1)
        answer = certificate if np.isnan(value) else f"planned, mean z {value:.4f}"
        rows.append((name, answer, str(pairs), f"{cpu:.1f}", f"{memory:.0f}"))
        print(*rows[-1], file=sys.stderr, flush=True)
    headings = ("arm, path and cell", "answer", "pairs", "processor, s", "memory, MB")
    return markdown_table(headings, rows, left=2)


if __name__ == "__main__":
    parts = {"plan_waypoints": plan_waypoints, "plan_sizes": plan_sizes}
    sys.exit(command(__doc__, parts))
