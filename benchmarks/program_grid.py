"""Programs of all languages, simulated at 1 ms: python benchmarks/programs.py grid.

Six robots of each language, one on a rail and one beside a positioner, move a tool of five
directions along a wave of 200 by 20 mm at 0.1 m/s, by joint moves and by straight ones. A reading
and a kinematics of the tests' own (``tests/oracles/program_simulator.py``) move the robot as the
language says; it fails if a joint steps by more than 0.5° in a millisecond, or does not arrive with
the configuration that the program states.

Points and times say nothing of accelerations between them. They are judged on a smooth curve
through the points at the program's times, scipy's spline of degree five, at rest where the program
stops; those of the motion file, from which the program is made, on its own polynomials. A spline
overshoots where jerks jump. So *least* is what the points ask for, by linear programs: the least
share of the limits of acceleration and jerk within which some motion passes all of them, to half of
the last digit that is printed, at the program's times.
Limits are the data sheet's speeds, full speed within 0.25 s and full acceleration within 50 ms.
"""

from __future__ import annotations

import itertools
import math
import tempfile
from pathlib import Path

import mujoco
import numpy as np
from oracles.data_sheets import SHEETS, data_of
from oracles.program_cells import LENGTH, Job, job_of, measured
from oracles.program_rows import DECIMALS
from oracles.program_simulator import Controller, Motion, Move, read
from scipy import sparse
from scipy.interpolate import BPoly, BSpline, make_interp_spline
from scipy.optimize import linprog

from qp_twist.checks import Array
from qp_twist.errors import InvalidInput
from qp_twist.programs import DIALECTS
from qp_twist.trajectories import write_checked
from qp_twist.trajectories.linear_moves import LinearMotion

ROBOTS = (
    ("ABB IRB 120", ""), ("ABB IRB 1600-6/1.2", ""), ("ABB IRB 1200-5/0.9", ""),
    ("ABB IRB 2400", ""), ("ABB IRB 4600-60/2.05", "rail"), ("ABB IRB 4600-60/2.05", "positioner"),
    ("KUKA KR 16-2", ""), ("KUKA KR 6 R900 sixx", ""), ("KUKA KR 10 R1100 sixx", ""),
    ("KUKA KR 10 R1100 sixx", "rail"), ("KUKA KR 16-2", "rail"), ("KUKA KR 16-2", "positioner"),
    ("Fanuc LR Mate 200iD", ""), ("Fanuc M-710iC/50", ""), ("Fanuc M-16iB/20", ""),
    ("Fanuc M-20iA", ""), ("Fanuc M-20iA", "rail"), ("Fanuc M-20iA", "positioner"),
    ("Universal Robots UR3e", ""), ("Universal Robots UR5e", ""), ("Universal Robots UR10e", ""),
    ("Universal Robots UR20", ""), ("Universal Robots UR5e", "rail"),
    ("Universal Robots UR10e", "positioner"),
)  # fmt: skip


MOTIONS = ("joint", "joints", "poses")
HEADINGS = (
    "points per m", "off the path, mm", "axis, °", "speed, %", "acceleration, %", "jerk, %",
    "least, %",
)  # fmt: skip
_UNIT = 0.01
"""Of times in the linear programs, s, so that their numbers are near 1."""
_PARTS = 3
"""Of a move, on each of which the jerk is constant."""


def grid() -> None:
    """Print the table; in each cell joint moves, straight ones to joints, and to poses."""
    print(f"| robot | | {' | '.join(HEADINGS)} | file: acceleration, jerk, % |")
    print(f"| {' | '.join([':--'] * (3 + len(HEADINGS)))} |")
    with tempfile.TemporaryDirectory() as folder:
        for name, extra in ROBOTS:
            job = job_of(name, extra)
            cells = zip(
                *(cell(job, extra, motion, Path(folder)) for motion in MOTIONS), strict=True
            )
            own = " / ".join(f"{100.0 * share:.0f}" for share in of_file(job))
            print(
                f"| {name} | {extra} | {' | '.join(map(' / '.join, cells))} | {own} |", flush=True
            )


def cell(job: Job, extra: str, motion: str, folder: Path) -> tuple[str, ...]:
    """Figures of a program; ``motion``: ``"joint"``, or the points of straight moves."""
    path, name = folder / f"wave{job.suffix}", job.cell.name
    by_value = not extra and name in SHEETS  # whose flange the test knows
    linear = None if motion == "joint" else LinearMotion(points=motion)  # type: ignore[arg-type]
    if motion == "poses" and not by_value:
        linear = LinearMotion(2, 7, "poses")
    try:
        check, written = write_checked(job.rows, path, job.task, job.joints, linear=linear)
    except InvalidInput as refusal:
        assert "not written in" in str(refusal) or job.suffix == ".script", refusal
        return ("–",) * len(HEADINGS)
    assert written, check.verdict
    program = read(path.read_text(), job.suffix)
    motion_of = Controller(job.cell, program).run()
    own = [job.cell.model.joint(each).qposadr[0] for each in job.cell.joints]
    for move, at in zip(program.moves[1:], motion_of.corners[1:], strict=True):
        theta = np.degrees(job.cell.signs * motion_of.q[at, own] + job.cell.offsets)
        known = move.data and name in SHEETS
        assert not known or data_of(name, theta) == move.data, "another configuration"
    found = measured(job, motion_of)
    shares = through_points(job, motion_of, program.moves)
    return (
        f"{len(program.moves) / LENGTH:.0f}", f"{1e3 * found.off_path:.3f}",
        f"{np.degrees(found.off_axis):.4f}", f"{100.0 * found.speed:.0f}",
        *(f"{100.0 * share:.0f}" for share in shares),
    )  # fmt: skip


def through_points(job: Job, motion: Motion, moves: list[Move]) -> Array:
    """Largest shares of the limits of acceleration and jerk on splines through the points.

    And the largest of the least shares of both.
    """
    at, found = np.array(motion.corners), list[tuple[float, float, float]]()
    rest = [(order, np.zeros(motion.q.shape[1])) for order in (1, 2)]
    through = [move.zone * move.share > 0.0 or move.rates is not None for move in moves]
    if job.suffix == ".src":  # one spline through the points of all joint moves
        through = [passed or not move.straight for passed, move in zip(through, moves, strict=True)]
    stops = np.flatnonzero(~np.array(through)).tolist()
    for first, last in itertools.pairwise(sorted({0, *stops, len(moves) - 1})):
        points = at[first : last + 1]
        spline = make_interp_spline(motion.times[points], motion.q[points], 5, bc_type=(rest, rest))
        least = _least(job, motion.times[points], motion.q[points])
        found.append((*_used(job, spline, *motion.times[points[[0, -1]]]), least))
    return np.asarray(np.max(found, axis=0))


def _least(job: Job, times: Array, q: Array) -> float:
    """The least share of the limits within which joints pass points (K, n), from rest to rest."""
    dialect = next(each for each in DIALECTS.values() if each.suffix == job.suffix)
    half = 0.5 * 10.0 ** -DECIMALS[dialect.name][0]
    slides = job.cell.model.jnt_type == mujoco.mjtJoint.mjJNT_SLIDE
    digits = half * np.where(slides, 1e-3, 1.0 if dialect.unit == "rad" else np.radians(1.0))
    of = zip(q.T, digits, job.limits.acceleration, job.limits.jerk, strict=True)  # type: ignore[arg-type]
    return max(_least_share(times, *each) for each in of)


def _least_share(times: Array, q: Array, digit: float, acceleration: float, jerk: float) -> float:
    """Likewise of one joint, (K,), which may be a digit beside each point.

    Unknown are position, speed and acceleration where pieces of constant jerk meet, in units of
    ``_UNIT`` and the limit of jerk, these jerks, and the share.
    """
    places = np.arange(_PARTS * (len(times) - 1) + 1) / _PARTS
    h = np.diff(np.interp(places, np.arange(len(times)), times)) / _UNIT
    n, unit = len(h), jerk * _UNIT**3
    here, changes = sparse.eye(n, n + 1), sparse.eye(n, n + 1, 1) - sparse.eye(n, n + 1)
    by = [sparse.diags(-(h**k) / math.factorial(k)) for k in range(4)]
    none = sparse.csr_matrix((n, 1))
    follow = sparse.bmat([
        [changes, by[1] @ here, by[2] @ here, by[3], none],
        [None, changes, by[1] @ here, by[2], None],
        [None, None, changes, by[1], None],
    ])  # fmt: skip
    limited = sparse.eye(2 * n + 1)
    most = np.append(np.full(n + 1, acceleration * _UNIT**2 / unit), np.ones(n))[:, None]
    pad = sparse.csr_matrix((2 * n + 1, 2 * n + 2))
    within = sparse.bmat([[pad, limited, -most], [pad, -limited, -most]])
    low, high = np.full((2, 4 * n + 4), [[-np.inf], [np.inf]])
    low[: n + 1 : _PARTS], high[: n + 1 : _PARTS] = (
        (q - q[0] - digit) / unit,
        (q - q[0] + digit) / unit,
    )
    for at in (n + 1, 2 * n + 1, 2 * n + 2, 3 * n + 2):  # at rest
        low[at] = high[at] = 0.0
    cost, bounds = np.append(np.zeros(4 * n + 3), 1.0), np.column_stack([low, high])
    of = cost, within, np.zeros(4 * n + 2), follow, np.zeros(3 * n), bounds
    solved = (linprog(*of, method=method) for method in ("highs-ipm", "highs-ds"))
    return next(float(found.fun) for found in solved if found.status == 0)


def of_file(job: Job) -> tuple[float, float]:
    """Those of the motion that the program is made from."""
    rows = job.rows
    of = zip(rows.q, rows.velocities, rows.accelerations, strict=True)  # type: ignore[arg-type]
    return _used(job, BPoly.from_derivatives(rows.times, list(of)), 0.0, rows.times[-1])  # type: ignore[index, arg-type]


def _used(job: Job, curve: BPoly | BSpline, begin: float, end: float) -> tuple[float, float]:
    """Largest shares of the limits of acceleration and jerk at 1 ms."""
    times, limits = np.arange(begin, end, 1e-3), (job.limits.acceleration, job.limits.jerk)
    acceleration, jerk = (
        float((np.abs(curve(times, order)) / limit).max())
        for order, limit in zip((2, 3), limits, strict=True)
    )
    return acceleration, jerk
