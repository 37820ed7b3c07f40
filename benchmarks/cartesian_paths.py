"""Plans for public problems: whole Cartesian paths among obstacles, all six directions prescribed.

    python benchmarks/cartesian_paths.py --cppflow DIR --jrl DIR --out OUT
        [--problems panda__1cube,panda__2cubes] [--objective travel|centering]

DIR are checkouts of github.com/jstmn/cppflow (paths and boxes) and github.com/jstmn/Jrl (robots),
which are read only; nothing of them is kept here. All thirteen problems are planned: three of the
panda and five of the fetch's arm, which have seven joints, so that one degree is free, and five of
the fetch with the lift of its torso, which makes it two.

A robot has one capsule a link. Pairs that may touch are those that its makers leave out, and links
that a joint connects; boxes must not be touched by any link that moves. A plan is free to choose
its start. From a pose to the next no hinge turns by more than 7 degrees, and no slide moves by more
than 2 cm.

OUT/PROBLEM.csv has a row for each pose: the joints in the robot's order, rad or m, no header.
OUT/results.json has for each problem the wall and the processor's seconds of the plan, compilation
left out, its value, bound and gap, and what a judge measures that shares nothing with the planner
but the model: poses by MuJoCo's kinematics, distances by MuJoCo at the poses and at 20 points on
the straight joint motion from each to the next.
"""

import page  # noqa: F401  (threads: before numpy)

# isort: split
import argparse
import csv
import itertools
import json
import re
import sys
import time
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import mink
import mujoco
import numpy as np
import yaml

import qp_twist as qt
from qp_twist.checks import Array, Indices, Mask
from qp_twist.errors import InvalidInput
from qp_twist.files import write_atomically
from qp_twist.planning.hard_constraints import BETWEEN as BETWEEN_POSES

STEP_DEG, SLIDE = 7.0, 0.02
"""Longest steps of hinges, degrees, and of slides, m."""
POSITION, ANGLE = 1e-4, np.radians(0.1)
"""Largest pose errors that are valid, m and rad."""
APART = BETWEEN_POSES["m"]
"""Clearance asked of a plan, m: what it may lack between poses, so that nothing touches there."""
BETWEEN = 20
"""Number of points between two poses at which distances are measured."""


@dataclass(frozen=True)
class Arm:
    """What the files of a robot do not say.

    Attributes:
        urdf: Its URDF, in jrl/urdfs.
        tip: The link that follows the path.
        joints: The joints that move, in the order of the rows; all others are fixed at 0.
        capsules: File of each link's capsule, in jrl/urdfs.
        ignored: Pairs of links that may touch, besides those that a joint connects.
    """

    urdf: str
    tip: str
    joints: tuple[str, ...]
    capsules: Mapping[str, str]
    ignored: tuple[tuple[str, str], ...]


def _panda() -> Arm:
    names = {str(k): f"panda_link{k}" for k in range(8)} | {"hand": "panda_hand"}
    files = {k: f"panda/capsules/{'link' if k.isdigit() else ''}{k}.txt" for k in names}
    apart = [
        "02",
        "03",
        "04",
        "13",
        "14",
        "24",
        "35",
        "36",
        "37",
        "46",
        "47",
        "57",
    ]  # as jrl/robots.py lists them
    return Arm(
        urdf="panda/panda_arm_hand_formatted.urdf",
        tip="panda_hand",
        joints=tuple(f"panda_joint{k}" for k in range(1, 8)),
        capsules={names[k]: files[k] for k in names},
        ignored=(*((names[a], names[b]) for a, b in apart), ("panda_hand", "panda_link7")),
    )


def _fetch(lift: bool) -> Arm:
    """With the lift of its torso, which leaves two degrees free, or without."""
    arm = "shoulder_pan shoulder_lift upperarm_roll elbow_flex forearm_roll wrist_flex wrist_roll"
    links = ["base", "torso_lift", *arm.split(), "gripper", "head_tilt"]
    apart = {  # as jrl/robots.py lists them
        "base": "shoulder_pan shoulder_lift upperarm_roll head_tilt",
        "torso_lift": "shoulder_lift",
        "shoulder_pan": "upperarm_roll elbow_flex forearm_roll wrist_flex wrist_roll head_tilt",
        "shoulder_lift": "elbow_flex forearm_roll wrist_flex wrist_roll head_tilt",
        "upperarm_roll": "forearm_roll wrist_flex wrist_roll gripper",
        "elbow_flex": "wrist_flex wrist_roll gripper",
        "forearm_roll": "gripper",
        "wrist_flex": "gripper",
    }
    return Arm(
        urdf="fetch/fetch_formatted.urdf",
        tip="gripper_link",
        joints=tuple(f"{k}_joint" for k in ["torso_lift"] * lift + arm.split()),
        capsules={f"{k}_link": f"fetch/capsules/{k}_link_collision.txt" for k in links},
        ignored=tuple((f"{a}_link", f"{b}_link") for a in apart for b in apart[a].split()),
    )


ARMS = {"panda": _panda(), "fetch_arm": _fetch(lift=False), "fetch": _fetch(lift=True)}
_FETCH = ("circle", "hello", "rot_yz2", "s", "square")
PROBLEMS = (
    *(f"panda__{path}" for path in ("1cube", "2cubes", "flappy_bird")),
    *(f"{robot}__{path}" for robot in ("fetch_arm", "fetch") for path in _FETCH),
)


# ---------------------------------------------------------------- a problem, as it is read


@dataclass(frozen=True, eq=False)
class Problem:
    """A problem.

    Attributes:
        task: The path, with the clearance asked of a plan.
        pairs: Ids of the geoms that must not touch, (P, 2): those that the judge looks at.
    """

    task: qt.PathTask
    pairs: Indices


def read_problem(cppflow: Path, jrl: Path, name: str, arms: Mapping[str, Arm] = ARMS) -> Problem:
    """A problem of the checkouts.

    Raises:
        InvalidInput: If a file is missing, or the robot is not one of ``arms``.
    """
    stated = yaml.safe_load(_text(cppflow / f"cppflow/problems/{name}.yaml"))
    if stated["robot"] not in arms:
        raise InvalidInput(
            f"{name}: robot {stated['robot']!r} is not taken yet; robots: {', '.join(arms)}."
        )
    arm = arms[stated["robot"]]
    urdfs = jrl / "jrl/urdfs"
    boxes = [
        {key: value for entry in box for key, value in entry.items()}
        for box in stated.get("obstacles") or []
    ]
    model, ignored = _scene(urdfs, arm, boxes, stated.get("obstacle_xyz_offset", (0.0, 0.0, 0.0)))
    rows = csv.reader(_text(cppflow / f"cppflow/paths/{stated['path_name']}.csv").splitlines()[1:])
    poses = np.array([[float(cell) for cell in row] for row in rows])[:, 1:]
    slides = _slides(model)
    task = qt.PathTask(
        name=name,
        title=f"{name}, a public problem",
        source=None,
        scene=urdfs / arm.urdf,
        model=model,
        frame_name=arm.tip,
        frame_type="body",
        projector=qt.TwistProjector(linear=qt.Projector.full(), angular=qt.Projector.full()),
        operational=qt.TwistProjector(linear=qt.Projector.full(), angular=qt.Projector.full()),
        waypoints=tuple(_waypoints(model, stated, poses)),
        flipped_waypoints=None,
        start=model.jnt_range.mean(axis=1),
        durations=np.append(0.0, np.ones(len(poses) - 1)) if slides.any() else None,
        velocity_limits=np.where(slides, SLIDE, np.inf),  # m in a step of a second
        acceleration_limits=np.full(model.nv, np.inf),
        constraints=(qt.Clearance(model, APART, ignored),),
    )
    return Problem(task, _watched(model, ignored))


def _slides(model: mujoco.MjModel) -> Mask:
    """Which joints are slides, (nv,)."""
    return np.asarray(model.jnt_type == mujoco.mjtJoint.mjJNT_SLIDE)


def _text(path: Path) -> str:
    if not path.is_file():
        raise InvalidInput(f"{path}: there is no such file; give the folder of the checkout.")
    return path.read_text("utf-8-sig")


def _waypoints(
    model: mujoco.MjModel, stated: Mapping[str, Any], poses: Array
) -> Iterator[mink.SE3]:
    """The poses of a path (N, 7), moved and turned as the problem says."""
    offset = np.array(stated["path_xyz_offset"], dtype=np.float64)
    if stated["path_offset_frame"] != "world":
        data = mujoco.MjData(model)
        data.qpos[:] = 0.0
        mujoco.mj_kinematics(model, data)
        offset = offset + data.body(stated["path_offset_frame"]).xpos
    turn = mink.SO3.from_matrix(np.array(stated["path_R_offset"], dtype=np.float64))
    for pose in poses:
        rotation = mink.SO3(pose[3:] / np.linalg.norm(pose[3:])) @ turn
        yield mink.SE3.from_rotation_and_translation(rotation, pose[:3] + offset)


def robot_of(urdfs: Path, arm: Arm) -> tuple[ElementTree.Element, list[tuple[str, str]]]:
    """The URDF of a robot without meshes and masses, and the links that a joint connects."""
    robot = ElementTree.fromstring(_text(urdfs / arm.urdf))
    for link in robot.findall("link"):
        link[:] = []
    jointed = []
    for joint in robot.findall("joint"):
        jointed.append((joint.find("parent").get("link"), joint.find("child").get("link")))
        if joint.get("name") not in arm.joints:
            joint.set("type", "fixed")
        elif joint.get("type") == "continuous":  # counts as half a turn either way
            joint.set("type", "revolute")
            limit = joint.find("limit")
            limit = ElementTree.SubElement(joint, "limit") if limit is None else limit
            limit.set("lower", str(-np.pi)), limit.set("upper", str(np.pi))
    return robot, jointed


def _scene(
    urdfs: Path, arm: Arm, boxes: list[dict[str, float]], offset: Any
) -> tuple[mujoco.MjModel, list[tuple[str, str]]]:
    """The robot with its capsules and the boxes, and the pairs of geoms that may touch."""
    robot, jointed = robot_of(urdfs, arm)
    settings = ElementTree.SubElement(robot, "mujoco")
    # The links of fixed joints keep their names.
    ElementTree.SubElement(
        settings, "compiler", fusestatic="false", boundmass="0.001", boundinertia="0.000001"
    )
    spec = mujoco.MjSpec.from_string(ElementTree.tostring(robot, encoding="unicode"))
    bodies = {body.name: body for body in spec.bodies}
    for link, file in arm.capsules.items():
        *ends, radius = map(float, re.split(r"[,\s]+", _text(urdfs / file).strip()))
        bodies.get(link, spec.worldbody).add_geom(  # a root may be merged with the world
            name=_geom(link),
            type=mujoco.mjtGeom.mjGEOM_CAPSULE,
            fromto=ends,
            size=[radius, 0.0, 0.0],
        )
    for number, box in enumerate(boxes, start=1):
        spec.worldbody.add_geom(
            name=f"box {number}",
            type=mujoco.mjtGeom.mjGEOM_BOX,
            pos=[box[axis] + shift for axis, shift in zip("xyz", offset, strict=True)],
            size=[0.5 * box[f"size_{axis}"] for axis in "xyz"],
        )
    model = spec.compile()
    order = [model.joint(k).name for k in range(model.njnt)]
    if order != list(arm.joints):
        raise InvalidInput(f"{arm.urdf}: joints {order}; expected {list(arm.joints)}.")
    ignored = [
        (_geom(a), _geom(b))
        for a, b in itertools.chain(arm.ignored, jointed)
        if a in arm.capsules and b in arm.capsules
    ]
    return model, ignored


def _geom(link: str) -> str:
    """Name of a link's capsule: other than the link's, which stands for all geoms fixed to it."""
    return f"{link} capsule"


def _watched(model: mujoco.MjModel, ignored: list[tuple[str, str]]) -> Indices:
    """All pairs of geoms that move against each other, but the ignored ones."""
    allowed = {frozenset(pair) for pair in ignored}
    rigid = model.body_weldid[model.geom_bodyid]
    return np.array(
        [
            (a, b)
            for a, b in itertools.combinations(range(model.ngeom), 2)
            if rigid[a] != rigid[b]
            and frozenset((model.geom(a).name, model.geom(b).name)) not in allowed
        ],
        dtype=np.intp,
    ).reshape(-1, 2)


# ---------------------------------------------------------------- the judge


def judged(problem: Problem, q: Array) -> dict[str, Any]:
    """What is true of a joint path (N, nq), by MuJoCo alone."""
    task, model = problem.task, problem.task.model
    data = mujoco.MjData(model)
    position = angle = 0.0
    at, between = np.inf, np.inf
    for k, (row, waypoint) in enumerate(zip(q, task.waypoints, strict=True)):
        at = min(at, _least_distance(problem, data, row))
        body = data.body(task.frame_name)
        position = max(position, float(np.linalg.norm(body.xpos - waypoint.translation())))
        turn = waypoint.rotation().inverse() @ mink.SO3(body.xquat.copy())
        angle = max(angle, float(np.linalg.norm(turn.log())))
        if k:
            for share in np.arange(1, BETWEEN + 1) / (BETWEEN + 1):
                point = q[k - 1] + share * (row - q[k - 1])
                between = min(between, _least_distance(problem, data, point))
    steps = np.abs(np.diff(q, axis=0))
    lower, upper = model.jnt_range.T
    inside = bool(((q >= lower - 1e-9) & (q <= upper + 1e-9)).all())
    on_path = position <= POSITION and angle <= ANGLE
    slides = _slides(model)
    turns, moves = steps[:, ~slides], steps[:, slides]
    largest = float(np.degrees(turns.max()))
    slow = largest <= STEP_DEG + 1e-6 and moves.max(initial=0.0) <= SLIDE + 1e-9
    valid = bool(inside and on_path and slow and at >= 0.0)
    return {
        "valid": valid,
        "valid_between": bool(valid and between >= 0.0),
        "length_rad": float(turns.sum()),
        "length_m": float(moves.sum()),
        "max_step_deg": largest,
        "min_clearance_m": min(at, between),
        "position_error_m": position,
        "angle_error_deg": float(np.degrees(angle)),
    }


def _least_distance(problem: Problem, data: mujoco.MjData, q: Array) -> float:
    """Least distance of the pairs at a configuration (nq,), m."""
    data.qpos[:] = q
    mujoco.mj_kinematics(problem.task.model, data)
    points = np.zeros(6)
    return min(
        (
            mujoco.mj_geomDistance(problem.task.model, data, int(a), int(b), 10.0, points)
            for a, b in problem.pairs
        ),
        default=np.inf,
    )


# ---------------------------------------------------------------- plans


def planned(problem: Problem, objective: str, out: Path) -> dict[str, Any]:
    """Plan a problem, write its rows, and say what they are."""
    wall, cpu = time.perf_counter(), time.process_time()
    plan = qt.plan(problem.task, objective, max_step_deg=STEP_DEG)
    result: dict[str, Any] = {
        "seconds": time.perf_counter() - wall,
        "processor_seconds": time.process_time() - cpu,
        "objective": objective,
        "valid": False,
        "valid_between": False,
    }
    if plan.q is None:
        return result | {"why": str(plan.certificate)}
    text = "".join(",".join(f"{value:.12g}" for value in row) + "\n" for row in plan.q)
    write_atomically(out / f"{problem.task.name}.csv", text)
    bound = {"value": plan.value, "bound": _number(plan.bound), "gap": _number(plan.gap)}
    return result | judged(problem, plan.q) | bound


def _number(value: float) -> float | None:
    """For JSON, which has no NaN."""
    return float(value) if np.isfinite(value) else None


def main(arguments: list[str] | None = None, arms: Mapping[str, Arm] = ARMS) -> int:
    """Plan the problems; returns 1 if one is not valid at and between its poses."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    for folder in ("cppflow", "jrl", "out"):
        parser.add_argument(f"--{folder}", type=Path, required=True)
    parser.add_argument("--problems", default=",".join(PROBLEMS))
    parser.add_argument("--objective", default="travel", choices=("travel", "centering"))
    given = parser.parse_args(arguments)
    results = {}
    try:
        problems = [
            read_problem(given.cppflow, given.jrl, name, arms) for name in given.problems.split(",")
        ]
    except InvalidInput as error:
        parser.error(str(error))
    for number, problem in enumerate(problems):
        if not number:  # machine code is compiled, or loaded, by a plan that does not count
            qt.plan(_beginning(problem.task), given.objective, max_step_deg=STEP_DEG)
        results[problem.task.name] = planned(problem, given.objective, given.out)
        write_atomically(given.out / "results.json", json.dumps(results, indent=1) + "\n")
        print(problem.task.name, json.dumps(results[problem.task.name]), flush=True)
    return 0 if all(found["valid_between"] for found in results.values()) else 1


def _beginning(task: qt.PathTask) -> qt.PathTask:
    """The first poses of a path."""
    durations = None if task.durations is None else task.durations[:3]
    return replace(task, waypoints=task.waypoints[:3], durations=durations)


if __name__ == "__main__":
    sys.exit(main())
