"""Plans with the fewest lift-offs of a public path that no single motion follows.

    python benchmarks/interrupted_paths.py --iklink DIR [--turns 0,30,60] [--speeds 1,2]
        [--robots panda] [--touching]

DIR is a checkout of github.com/uwgraphics/IKLink, which is read only; nothing of it is kept here.
Its path of 767 poses prescribes all six directions, 30 poses a second; joints keep the speeds of
their URDF. It is planned with ``objective="travel"`` as it is, turned about the base's axis (deg),
and faster. Each link is a capsule of the radius that the checkout states (50 mm), above a floor
0.35 m below the base; links up to three joints apart may touch. With ``--touching`` all may.

The table has the lift-offs, whether no motion has fewer, the travel of the joints on the path, that
of the joint moves, the processor's seconds (compilation left out), and what MuJoCo measures: the
largest distance from a pose, and the least between capsules at the rows and nine points between.
"""

import page  # noqa: F401  (threads: before numpy)

# isort: split
import argparse
import csv
import itertools
import time
from dataclasses import replace
from pathlib import Path
from xml.etree import ElementTree

import mink
import mujoco
import numpy as np

import qp_twist as qt
from qp_twist.checks import Array

TIPS = {
    "panda": "panda_hand", "iiwa": "iiwa_link_ee", "jaco": "j2s7s300_link_7", "ur5": "tool0",
    "sawyer": "right_hand",
}  # fmt: skip
_RADIUS, _FLOOR, _NEIGHBOURS, _CLEARANCE = 0.05, 0.35, 3, 1e-4


def arm(
    file: Path, tip: str, *, touching: bool
) -> tuple[mujoco.MjModel, Array, list[qt.Clearance]]:
    """The arm up to its tip, the speeds of its joints, rad/s, and its clearance."""
    robot = ElementTree.parse(file).getroot()
    for child in list(robot):
        if child.tag not in ("link", "joint"):
            robot.remove(child)
        elif child.tag == "link":
            child[:] = []
    joints = {joint.find("child").get("link"): joint for joint in robot.iter("joint")}
    chain = []
    while tip in joints:
        chain.insert(0, joints[tip])
        tip = joints[tip].find("parent").get("link")
    speeds = {}
    for joint in robot.iter("joint"):
        joint[:] = [part for part in joint if part.tag not in ("mimic", "safety_controller")]
        if joint not in chain:
            joint.set("type", "fixed")
        if joint.get("type") != "fixed":
            speeds[joint.get("name")] = float(joint.find("limit").get("velocity"))
    settings = ElementTree.SubElement(robot, "mujoco")
    ElementTree.SubElement(
        settings, "compiler", fusestatic="false", boundmass="0.001", boundinertia="0.000001"
    )
    spec = mujoco.MjSpec.from_string(ElementTree.tostring(robot, encoding="unicode"))
    capsules = []
    for joint in chain if not touching else ():
        to = np.array(joint.find("origin").get("xyz", "0 0 0").split(), dtype=float)
        body = next((b for b in spec.bodies if b.name == joint.find("parent").get("link")), None)
        if np.linalg.norm(to) > 0.02 and body is not None:
            capsules.append(f"to {joint.get('name')}")
            body.add_geom(
                name=capsules[-1], type=mujoco.mjtGeom.mjGEOM_CAPSULE, fromto=[0, 0, 0, *to],
                size=[_RADIUS, 0, 0],
            )  # fmt: skip
    if capsules:
        spec.worldbody.add_geom(
            name="floor", type=mujoco.mjtGeom.mjGEOM_BOX, size=[2, 2, 0.05],
            pos=[0, 0, -_FLOOR - 0.05],
        )  # fmt: skip
    model = spec.compile()
    ignored = [
        (a, b) for k, a in enumerate(capsules) for b in capsules[k + 1 : k + 1 + _NEIGHBOURS]
    ]
    clearance = [qt.Clearance(model, _CLEARANCE, ignored)] if capsules else []
    return model, np.array([speeds[model.joint(k).name] for k in range(model.njnt)]), clearance


def read_task(folder: Path, robot: str, *, touching: bool) -> qt.PathTask:
    """The path of the checkout, for one of its robots."""
    file = folder / f"configs/urdfs/{robot}.urdf"
    model, speeds, clearance = arm(file, TIPS[robot], touching=touching)
    (path,) = (folder / "input_trajectories").glob("*.csv")
    rows = np.array(list(csv.reader(path.read_text().splitlines()))[1:], dtype=float)
    every = qt.TwistProjector(linear=qt.Projector.full(), angular=qt.Projector.full())
    return qt.PathTask(
        name=robot, title=f"{path.stem}, a public path", source=None, scene=file, model=model,
        frame_name=TIPS[robot], frame_type="body", projector=every, operational=every,
        waypoints=tuple(
            mink.SE3.from_rotation_and_translation(
                mink.SO3(row[[7, 4, 5, 6]] / np.linalg.norm(row[4:])), row[1:4]
            )
            for row in rows
        ),
        flipped_waypoints=None, start=np.where(model.jnt_limited > 0, model.jnt_range.mean(1), 0.0),
        durations=np.append(0.0, np.diff(rows[:, 0])), velocity_limits=speeds,
        acceleration_limits=np.full(model.nv, np.inf), constraints=tuple(clearance),
    )  # fmt: skip


def turned(task: qt.PathTask, degrees: float, speed: float) -> qt.PathTask:
    """The path turned about the base's axis, and so many times as fast."""
    turn = mink.SE3.from_rotation(mink.SO3.from_z_radians(np.radians(degrees)))
    assert task.durations is not None
    return replace(
        task,
        waypoints=tuple(turn @ pose for pose in task.waypoints),
        durations=task.durations / speed,
    )


def measured(plan: qt.Plan) -> tuple[float, float]:
    """Largest distance from a pose, and least one of a pair that may not touch, m; by MuJoCo."""
    task, q = plan.path_task, plan.motion()
    data, off, apart = mujoco.MjData(task.model), 0.0, np.inf
    for row, pose in zip(plan.at_waypoints, task.waypoints, strict=True):
        data.qpos[:] = row
        mujoco.mj_kinematics(task.model, data)
        xpos = data.body(task.frame_name).xpos
        off = max(off, float(np.linalg.norm(xpos - pose.translation())))
    for clearance in task.clearances:
        for a, b in itertools.pairwise(q):
            for share in np.arange(10) / 10.0:
                data.qpos[:] = a + share * (b - a)
                mujoco.mj_kinematics(task.model, data)
                for pair in clearance.pairs:
                    distance = mujoco.mj_geomDistance(task.model, data, *pair, 0.02, None)
                    apart = min(apart, distance)
    return off, apart


def row(task: qt.PathTask, name: str) -> tuple[str, bool]:
    """A row of the table, and whether there is a plan."""
    began = time.process_time()
    plan = qt.plan(task, "travel", cuts="fewest")
    seconds = time.process_time() - began
    if plan.q is None:
        return f"| {name} | none: {plan.certificate} | | | | {seconds:.1f} | |", False
    path = plan.path_task.at(plan.s)
    travel = np.abs(np.diff(plan.q, axis=0)).sum(axis=1)
    on, moves = travel[~path.moves].sum(), travel[path.moves].sum()
    certificate = str(plan.certificate)
    least = "proved" if not plan.cuts or "no motion lifts it" in certificate else "found"
    off, apart = measured(plan)
    found = f"{1e3 * off:.1e} mm" + (f", {1e3 * apart:.2f} mm" if np.isfinite(apart) else "")
    places = ", ".join(map(str, plan.cuts)) or "–"
    numbers = " | ".join(f"{value:.1f}" for value in (on, moves, seconds))
    return f"| {name} | {len(plan.cuts)} | {places} | {least} | {numbers} | {found} |", True


def main() -> int:
    """Print the table; returns 1 if a path has no plan."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("--iklink", type=Path, required=True)
    parser.add_argument("--robots", default="panda")
    parser.add_argument("--turns", default="0")
    parser.add_argument("--speeds", default="1")
    parser.add_argument("--touching", action="store_true")
    given = parser.parse_args()
    print(
        "| path | lift-offs | after poses | fewest | on the path, rad | joint moves, rad "
        "| processor, s | measured |\n| :-- | --: | :-- | :-- | --: | --: | --: | :-- |"
    )
    planned = []
    for robot in given.robots.split(","):
        task = read_task(given.iklink, robot, touching=given.touching)
        qt.plan(task.part(slice(20)), "travel", cuts="fewest")  # compiles, or loads, machine code
        for turn, speed in itertools.product(given.turns.split(","), given.speeds.split(",")):
            name = f"{robot}, {turn}°, {speed} ×"
            text, found = row(turned(task, float(turn), float(speed)), name)
            print(text, flush=True)
            planned.append(found)
    return 0 if all(planned) else 1


if __name__ == "__main__":
    raise SystemExit(main())
