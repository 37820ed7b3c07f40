"""Paths on a circle, and programs with a random one, by the tests' own kinematics."""

from functools import cache
from typing import NamedTuple

import mink
import numpy as np
from scipy.spatial.transform import Rotation

import qp_twist as qt
from oracles.data_sheets import about, data_of, links
from oracles.mounted_robots import AXIS, FULL, mounted, timed_rows
from oracles.tool_circles import length_of, moved, sweep_of
from oracles.ur_flange import LENGTHS, flange_of
from qp_twist.robots import ControllerJoints
from qp_twist.trajectories import TimedPath

Array = np.ndarray
POSTURES = {
    "ABB IRB 120": (10.0, 20.0, 10.0, 5.0, 50.0, 20.0),
    "KUKA KR 16-2": (10.0, -70.0, 95.0, 5.0, 50.0, 200.0),
    "Fanuc LR Mate 200iD": (10.0, 10.0, -20.0, 20.0, -60.0, 20.0),
    "Universal Robots UR10e": (-100.0, -120.0, 90.0, -50.0, 70.0, -150.0),
}
SUFFIXES = dict(zip(POSTURES, (".mod", ".src", ".ls", ".script"), strict=True))
RULES = {
    "ABB IRB 120": ("path", "space"), "KUKA KR 16-2": ("path", "space"),
    "Fanuc LR Mate 200iD": ("space",), "Universal Robots UR10e": ("space", "tangent"),
}  # fmt: skip


RADIUS, SPEED, SEAM = 0.045, 0.05, 75.0  # m, m/s, degrees


class Case(NamedTuple):
    """A task of a robot, its motion, and how its controller counts."""

    name: str
    task: qt.PathTask
    rows: TimedPath
    joints: ControllerJoints
    centre: Array


@cache
def case_of(name: str, kind: str) -> Case:
    """A hole's edge, whose axis is the tool's, or the seam of a cone, with which the tool turns."""
    arm = mounted(name, POSTURES[name])
    start = arm.start
    hole, waypoints = kind == "hole", []
    whole = np.radians(360.0 if hole else SEAM)
    lean = mink.SO3.exp(np.radians(np.array([0.0, 0.0 if hole else 15.0, 0.0])))
    for angle in np.linspace(0.0, whole, 181):
        turn = mink.SO3.exp(np.array([0.0, 0.0, 0.0 if hole else angle]))
        place = RADIUS * np.array([np.cos(angle) - 1.0, np.sin(angle), 0.0])
        waypoints.append(
            start @ mink.SE3.from_rotation_and_translation(lean.inverse() @ turn @ lean,
                                                           lean.inverse().apply(place))
        )  # fmt: skip
    durations = np.append(0.0, np.full(180, RADIUS * whole / 180.0 / SPEED))
    task = arm.task(kind, waypoints, durations, projector=AXIS if hole else FULL)
    centre = start.apply(lean.inverse().apply(np.array([-RADIUS, 0.0, 0.0])))
    return Case(name, task, *timed_rows(task, name), centre)


class RandomCircle(NamedTuple):
    """A program with a joint move and a circle from there, and where its tool is."""

    text: str
    rule: str
    tool: Array
    begin: Array
    via: Array
    end: Array
    theta: Array
    seconds: float

    def at(self, shares: Array) -> tuple[Array, Array]:
        """Positions and rotations of the tool in the base."""
        return moved(self.begin, self.end, shares, self.via, self.rule)


def flange(name: str, theta: Array) -> Array:
    """In the controller's base, at θ, degrees."""
    return flange_of(name, theta) if name in LENGTHS else links(name, theta)[-1]


def random_circle(name: str, rng: np.random.Generator) -> RandomCircle | None:
    """From a posture to one nearby, through a point beside; ``None`` if its turn is ambiguous."""
    first = np.array(POSTURES[name]) + rng.uniform(-8.0, 8.0, 6)
    last = first + rng.uniform(-3.0, 3.0, 6)
    tool = about("x", rng.uniform(-40.0, 40.0)) @ about("y", rng.uniform(-40.0, 40.0))
    tool[:3, 3] = rng.uniform(-0.1, 0.1, 3) + np.array([0.0, 0.0, 0.1])
    if name.startswith("Fanuc"):  # whose programs do not state a tool
        tool = np.eye(4)
    begin, end = (flange(name, theta) @ tool for theta in (first, last))
    chord = end[:3, 3] - begin[:3, 3]
    aside = np.cross(chord, rng.normal(size=3))
    aside *= rng.uniform(0.1, 0.5) * np.linalg.norm(chord) / np.linalg.norm(aside)
    via = begin[:3, 3] + rng.uniform(0.35, 0.65) * chord + aside
    rule = str(rng.choice(RULES[name]))
    seen = moved(begin, end, np.array([0.0, 0.499, 0.501]), via, rule)[1]
    rate = Rotation.from_matrix(seen[1].T @ seen[2]).magnitude() / 0.002
    most = 1.0 if rule == "tangent" else 3.0  # with which the tool turns wholly
    if sweep_of(begin[:3, 3], via, end[:3, 3]) > most or rate > 2.8:
        return None
    middle = moved(begin, end, np.array([_share(begin, via, end)]), via, rule)[1][0]
    between = np.eye(4)
    between[:3, :3], between[:3, 3] = middle, via
    if not name.startswith("Fanuc"):  # there the turn at the point does not count
        between[:3, :3] = Rotation.random(random_state=int(rng.integers(1 << 30))).as_matrix()
    speed = 1e-3 * int(rng.integers(10, 200))
    text = TEXTS[name](rule, tool, first, between, end, data_of, last, speed)
    seconds = length_of(begin, end, via) / speed
    if name.startswith("ABB"):  # whose speed data state 5000°/s
        seconds = max(seconds, rate / np.radians(5000.0))
    return RandomCircle(text, rule, tool, begin, via, end, last, seconds)


def _share(begin: Array, via: Array, end: Array) -> float:
    """Of the angle to the end, that to the point between: twice the inscribed angle at the end."""
    u, v = begin[:3, 3] - end[:3, 3], via - end[:3, 3]
    inscribed = np.arctan2(np.linalg.norm(np.cross(u, v)), u @ v)
    return float(2.0 * inscribed / sweep_of(begin[:3, 3], via, end[:3, 3]))


def _quaternion(pose: Array) -> str:
    x, y, z, w = Rotation.from_matrix(pose[:3, :3]).as_quat()
    values = ",".join(f"{1e3 * each:.6f}" for each in pose[:3, 3])
    return f"[{values}],[{w:.9f},{x:.9f},{y:.9f},{z:.9f}]"


def _angles(pose: Array) -> tuple[Array, Array]:
    return 1e3 * pose[:3, 3], Rotation.from_matrix(pose[:3, :3]).as_euler("ZYX", degrees=True)


def rapid(rule, tool, first, via, end, data, last, speed):  # type: ignore[no-untyped-def]
    axes = ",".join(f"{x:.8f}" for x in first)
    no = "[9E9,9E9,9E9,9E9,9E9,9E9]"
    cf = list(data("ABB IRB 120", last))
    mode = "" if rule == "path" else "  CirPathMode\\ObjectFrame;\n"
    return f"""MODULE other
PERS tooldata gun:=[TRUE,[{_quaternion(tool)}],[1,[0,0,50],[1,0,0,0],0,0,0]];
PROC main()
{mode}  MoveAbsJ [[{axes}],{no}],v100,fine,gun;
  MoveC [{_quaternion(via)},[0,0,0,0],{no}],
    [{_quaternion(end)},{cf},{no}],[{1e3 * speed:.0f},5000,1,1],fine,gun;
ENDPROC
ENDMODULE
"""


def krl(rule, tool, first, via, end, data, last, speed):  # type: ignore[no-untyped-def]
    def place(pose: Array, more: str = "") -> str:
        (x, y, z), (a, b, c) = _angles(pose)
        return f"{{X {x:.6f},Y {y:.6f},Z {z:.6f},A {a:.8f},B {b:.8f},C {c:.8f}{more}}}"

    axes = ",".join(f"A{k} {x:.8f}" for k, x in enumerate(first, start=1))
    s, t = data("KUKA KR 16-2", last)
    return f"""DEF other( )
$TOOL={place(tool)}
$BASE={{X 0,Y 0,Z 0,A 0,B 0,C 0}}
$CIRC_TYPE=#{"PATH" if rule == "path" else "BASE"}
$VEL.CP={speed:.3f}
PTP {{{axes}}}
CIRC {place(via)},{place(end, f",S {s},T {t}")}
END
"""


def fanuc(rule, tool, first, via, end, data, last, speed):  # type: ignore[no-untyped-def]
    def place(pose: Array, numbers: tuple[int, ...]) -> str:
        (x, y, z), (r, p, w) = _angles(pose)
        letters = " ".join(a if n else b for n, a, b in zip(numbers, "FDB", "NUT", strict=False))
        turns = ", ".join(map(str, numbers[3:]))
        return (
            f"   GP1:\n\tUF : 0, UT : 0,\tCONFIG : '{letters}, {turns}',\n"
            f"\tX= {x:.6f} mm, Y= {y:.6f} mm, Z= {z:.6f} mm,\n"
            f"\tW= {w:.8f} deg, P= {p:.8f} deg, R= {r:.8f} deg\n"
        )

    shown = np.array(first)
    shown[2] -= shown[1]
    axes = ", ".join(f"J{k}= {x:.8f} deg" for k, x in enumerate(shown, start=1))
    numbers = data("Fanuc LR Mate 200iD", last)
    return (
        "/PROG OTHER\n/ATTR\n/MN\n   1:J P[1] 10% FINE ;\n"
        f"   2:C P[2]\n    :  P[3] {1e3 * speed:.0f}mm/sec FINE ;\n/POS\n"
        f"P[1]{{\n   GP1:\n\tUF : 0, UT : 0,\n\t{axes}\n}};\n"
        f"P[2]{{\n{place(via, numbers)}}};\nP[3]{{\n{place(end, numbers)}}};\n/END\n"
    )


def script(rule, tool, first, via, end, data, last, speed):  # type: ignore[no-untyped-def]
    def place(pose: Array) -> str:
        turn = Rotation.from_matrix(pose[:3, :3]).as_rotvec()
        return f"p[{', '.join(f'{x:.9f}' for x in [*pose[:3, 3], *turn])}]"

    axes = ", ".join(f"{np.radians(x):.10f}" for x in first)
    mode = ", mode=1" if rule == "tangent" else ""
    return f"""def other():
  set_tcp({place(tool)})
  movej([{axes}], a=1, v=1)
  movec({place(via)}, {place(end)}, a=1.2, v={speed:.3f}, r=0{mode})
end
"""


TEXTS = dict(zip(POSTURES, (rapid, krl, fanuc, script), strict=True))
