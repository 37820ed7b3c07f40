"""Other planners on the problems of benchmarks/cartesian_paths.py: TrajOpt and Descartes.

    python benchmarks/cartesian_peers.py --cppflow DIR --jrl DIR --out OUT
        [--problems panda__1cube,…] [--peers trajopt,descartes] [--limit 120]

Both come with Tesseract, as the wheel ``tesseract-robotics-nanobind``, which this package neither
requires nor imports elsewhere: install it beside qp_twist in an environment of its own. Release
0.35.0.8 needs a libstdc++ of GCC 13; where the system's is older, ``libstdc++.so.6`` and
``libgcc_s.so.1`` of release 0.34.1.7 do, in a folder on ``LD_LIBRARY_PATH``.

Robots, capsules, boxes, pairs of links that may touch, and poses are those of the problems. Each
plan is made in a process of its own, since exceptions of these libraries end the interpreter; it is
ended after ``--limit`` seconds of the processor, loading included. The times stated are those of
planning, after plugins were loaded and the scene was read. Paths are judged as ours are
(``judged`` of cartesian_paths.py).

*trajopt*: the pipeline ``TrajOptPipeline`` with the library's own settings for Cartesian paths
(``create_trajopt_default_profiles``): poses as constraints, contacts as constraints at distance 0
and as costs up to 5 mm, evaluated continuously between the waypoints. All waypoints begin at a
configuration on the first pose, which is the first of our plan where OUT/NAME.csv has one, written
by cartesian_paths.py, and else a random one corrected onto it.

*descartes*: the pipeline ``DescartesFPipeline`` with its defaults and KDL's numerical inverse
kinematics, which returns one configuration a pose.

OUT/peers.json has the results.
"""

import page  # noqa: F401  (threads: before numpy)

# isort: split
import argparse
import json
import os
import resource
import signal
import subprocess
import sys
import time
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import mink
import numpy as np
from cartesian_paths import ARMS, PROBLEMS, Arm, Problem, judged, read_problem, robot_of

from qp_twist.checks import Array
from qp_twist.files import write_atomically
from qp_twist.kinematics import JointRanges
from qp_twist.planning.path_rows import PathRows

GROUP = "arm"
_CONTACTS = """contact_manager_plugins:
  search_libraries: [tesseract_collision_bullet_factories]
  discrete_plugins:
    default: BulletDiscreteBVHManager
    plugins: {BulletDiscreteBVHManager: {class: BulletDiscreteBVHManagerFactory}}
  continuous_plugins:
    default: BulletCastBVHManager
    plugins: {BulletCastBVHManager: {class: BulletCastBVHManagerFactory}}
"""
_KINEMATICS = """kinematic_plugins:
  search_libraries: [tesseract_kinematics_kdl_factories]
  fwd_kin_plugins:
    arm:
      default: KDLFwdKinChain
      plugins:
        KDLFwdKinChain: {class: KDLFwdKinChainFactory, config: {base_link: ROOT, tip_link: TIP}}
  inv_kin_plugins:
    arm:
      default: KDLInvKinChainLMA
      plugins:
        KDLInvKinChainLMA:
          class: KDLInvKinChainLMAFactory
          config: {base_link: ROOT, tip_link: TIP}
"""


# ---------------------------------------------------------------- the scene, as Tesseract reads it


def write_scene(problem: Problem, arm: Arm, urdfs: Path, folder: Path) -> str:
    """Write robot.urdf, robot.srdf and the plugins' settings into a folder; returns the root."""
    robot, _ = robot_of(urdfs, arm)
    for settings in robot.findall("mujoco"):
        robot.remove(settings)
    robot.set("xmlns:tesseract", "http://ros.org/wiki/tesseract")
    robot.set("tesseract:make_convex", "false")
    links = {link.get("name"): link for link in robot.findall("link")}
    children = {joint.find("child").get("link") for joint in robot.findall("joint")}
    [root] = set(links) - children
    model = problem.task.model
    names = []
    for geom in range(model.ngeom):
        name = model.geom(geom).name
        link = name.removesuffix(" capsule")
        if link not in links:  # a box of the problem, or the robot's root
            link = name.replace(" ", "_")
            links[link] = ElementTree.SubElement(robot, "link", name=link)
            joint = ElementTree.SubElement(robot, "joint", name=f"{link}_joint", type="fixed")
            ElementTree.SubElement(joint, "parent", link=root)
            ElementTree.SubElement(joint, "child", link=link)
        names.append(link)
        _add_shape(links[link], model, geom, merged=root)
    watched = {frozenset((names[a], names[b])) for a, b in problem.pairs}
    semantic = ElementTree.Element("robot", name=robot.get("name"))
    group = ElementTree.SubElement(semantic, "group", name=GROUP)
    tip = problem.task.frame_name
    ElementTree.SubElement(group, "chain", base_link=root, tip_link=tip)
    for kind in ("kinematics", "contact_managers"):
        file = folder / f"{kind}.yaml"
        ElementTree.SubElement(semantic, f"{kind}_plugin_config", filename=f"file://{file}")
    (folder / "contact_managers.yaml").write_text(_CONTACTS, "utf-8")
    kinematics = _KINEMATICS.replace("ROOT", root).replace("TIP", tip)
    (folder / "kinematics.yaml").write_text(kinematics, "utf-8")
    for i, one in enumerate(names):
        for other in names[i + 1 :]:
            if one != other and frozenset((one, other)) not in watched:
                ElementTree.SubElement(
                    semantic, "disable_collisions", link1=one, link2=other, reason="Never"
                )
    for name, tree in (("robot.urdf", robot), ("robot.srdf", semantic)):
        (folder / name).write_bytes(ElementTree.tostring(tree))
    return root


def _add_shape(link: ElementTree.Element, model: Any, geom: int, *, merged: str) -> None:
    """A geom of the model as the collision shape of its link, in the link's frame."""
    collision = ElementTree.SubElement(link, "collision")
    turn = mink.SO3(model.geom_quat[geom]).as_matrix()
    pitch = np.arcsin(np.clip(-turn[2, 0], -1.0, 1.0))
    roll, yaw = np.arctan2(turn[2, 1], turn[2, 2]), np.arctan2(turn[1, 0], turn[0, 0])
    ElementTree.SubElement(
        collision,
        "origin",
        xyz=" ".join(f"{v:.12g}" for v in model.geom_pos[geom]),
        rpy=f"{roll:.12g} {pitch:.12g} {yaw:.12g}",
    )
    shape, size = ElementTree.SubElement(collision, "geometry"), model.geom_size[geom]
    if model.geom(geom).name.startswith("box"):
        ElementTree.SubElement(shape, "box", size=" ".join(f"{2.0 * v:.12g}" for v in size))
    else:
        length = f"{2.0 * size[1]:.12g}"
        ElementTree.SubElement(shape, "tesseract:capsule", radius=f"{size[0]:.12g}", length=length)


# ---------------------------------------------------------------- plans, in a process of their own


def trajopt(problem: Problem, folder: Path, first: Array) -> tuple[Any, Array]:
    """TrajOpt with the library's settings; the result, its seconds and the processor's."""
    from tesseract_robotics.planning import create_trajopt_default_profiles

    profiles = create_trajopt_default_profiles()
    return _planned(problem, folder, first, "TrajOptPipeline", profiles)


def descartes(problem: Problem, folder: Path, first: Array) -> tuple[Any, Array]:
    """Descartes with the library's settings; returns as :func:`trajopt`."""
    from tesseract_robotics.planning.profiles import create_descartes_pipeline_profiles

    profiles = create_descartes_pipeline_profiles()
    return _planned(problem, folder, first, "DescartesFPipeline", profiles)


def _planned(
    problem: Problem, folder: Path, first: Array, pipeline: str, profiles: Any
) -> tuple[Any, Array]:
    """What a pipeline plans, and its time: only of the plan, not of loading and warming up."""
    from tesseract_robotics.planning import TaskComposer

    robot, program = _stated(problem, folder, first)
    composer = TaskComposer.from_config()
    composer.warmup([pipeline])
    began = _now()
    result = composer.plan(robot, program, pipeline=pipeline, profiles=profiles)
    return result, _now() - began


def _now() -> Array:
    """Seconds of the clock and of the processor."""
    return np.array([time.perf_counter(), time.process_time()])


PEERS = {f.__name__: f for f in (trajopt, descartes)}


def _stated(problem: Problem, folder: Path, first: Array) -> tuple[Any, Any]:
    """The robot at the configuration that all waypoints begin at, and the program of the path."""
    from tesseract_robotics.planning import CartesianTarget, MotionProgram, Pose, Robot

    task = problem.task
    names = [task.model.joint(k).name for k in range(task.model.njnt)]
    robot = Robot.from_files(str(folder / "robot.urdf"), str(folder / "robot.srdf"))
    robot.set_joints(first, joint_names=names)
    base = (folder / "root.txt").read_text("utf-8")
    program = MotionProgram(GROUP, tcp_frame=task.frame_name, working_frame=base)
    program.set_joint_names(names)
    for waypoint in task.waypoints:
        pose = Pose.from_matrix_position(waypoint.rotation().as_matrix(), waypoint.translation())
        program.linear_to(CartesianTarget(pose, profile="CARTESIAN"))
    return robot, program


def _first(problem: Problem, out: Path) -> Array:
    """A configuration on the first pose, (nq,)."""
    kept = out / f"{problem.task.name}.csv"
    if kept.exists():
        first: Array = np.loadtxt(kept, delimiter=",")[0]
        return first
    rows, ranges = PathRows(problem.task), JointRanges.of(problem.task.model)
    drawn = ranges.random(1000, np.random.default_rng(0))
    q, arrived = rows.correct(drawn, np.zeros(1000, dtype=np.intp))
    inside = arrived & ranges.inside(q)
    inside[inside] = problem.task.clearances[0].inside(q[inside], 0.0)
    chosen: Array = q[inside][0]
    return chosen


def made(problem: Problem, peer: str, given: argparse.Namespace) -> None:
    """Plan in this process; writes q.npy, if there is a path, and said.json."""
    folder = given.out / "peers" / f"{problem.task.name}__{peer}"
    result, (took, processor) = PEERS[peer](problem, folder, _first(problem, given.out))
    if result.successful:
        np.save(folder / "q.npy", result.to_numpy())
    said = {"seconds": took, "processor_seconds": processor, "why": result.message}
    write_atomically(folder / "said.json", json.dumps(said))
    sys.stdout.flush()
    os._exit(0)  # the library's threads may end with an error


def planned(problem: Problem, peer: str, given: argparse.Namespace) -> dict[str, Any]:
    """What another process plans within the limit, judged."""
    folder = (given.out / "peers" / f"{problem.task.name}__{peer}").absolute()
    folder.mkdir(parents=True, exist_ok=True)
    for old in ("q.npy", "said.json"):
        (folder / old).unlink(missing_ok=True)
    arm = ARMS[problem.task.name.partition("__")[0]]
    root = write_scene(problem, arm, given.jrl / "jrl/urdfs", folder)
    (folder / "root.txt").write_text(root, "utf-8")
    result: dict[str, Any] = {"valid": False, "valid_between": False}
    with (folder / "output.txt").open("w", encoding="utf-8") as output:
        ended = subprocess.run(
            [sys.executable, __file__, *sys.argv[1:], "--case", problem.task.name, peer],
            stdout=output,
            stderr=subprocess.STDOUT,
            check=False,
        ).returncode
    if ended == -signal.SIGXCPU:
        return result | {"why": f"nothing within {given.limit} s of the processor"}
    if not (folder / "said.json").exists():
        return result | {"why": "its process ended with an error"}
    said = json.loads((folder / "said.json").read_text("utf-8"))
    result |= said
    if not (folder / "q.npy").exists():
        return result
    del result["why"]
    q = np.load(folder / "q.npy")
    if q.shape != (len(problem.task.waypoints), problem.task.model.nq):
        return result | {"why": f"its path has {len(q)} rows"}
    return result | judged(problem, q)


def main() -> None:
    """Plan the problems with the peers, one after the other."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    for folder in ("cppflow", "jrl", "out"):
        parser.add_argument(f"--{folder}", type=Path, required=True)
    parser.add_argument("--problems", default=",".join(PROBLEMS))
    parser.add_argument("--peers", default=",".join(PEERS))
    parser.add_argument("--limit", type=int, default=120)
    parser.add_argument("--case", nargs=2, default=None, help=argparse.SUPPRESS)
    given = parser.parse_args()
    if given.case is not None:
        resource.setrlimit(resource.RLIMIT_CPU, (given.limit, given.limit + 5))
        problem = read_problem(given.cppflow, given.jrl, given.case[0])
        made(problem, given.case[1], given)
        return
    kept, results = given.out / "peers.json", {}
    if kept.exists():
        results = json.loads(kept.read_text("utf-8"))
    for name in given.problems.split(","):
        problem = read_problem(given.cppflow, given.jrl, name)
        for peer in given.peers.split(","):
            results[f"{name} {peer}"] = planned(problem, peer, given)
            write_atomically(kept, json.dumps(results, indent=1) + "\n")
            print(name, peer, json.dumps(results[f"{name} {peer}"]), flush=True)


if __name__ == "__main__":
    main()
