"""Programs of all languages, simulated at 1 ms: python benchmarks/programs.py grid.

Six robots of each language, one on a rail and one beside a positioner, move a tool of five
directions along a wave of 200 by 20 mm at 0.1 m/s, by joint moves and by straight ones. A reading
and a kinematics of the tests' own (``tests/oracles/program_simulator.py``) move the robot as the
language says; it fails if a joint steps by more than 0.5° in a millisecond, or does not arrive with
the configuration that the program states.
"""

from __future__ import annotations

import tempfile
from pathlib import Path

import numpy as np
from oracles.data_sheets import SHEETS, data_of
from oracles.program_cells import LENGTH, Job, job_of, measured
from oracles.program_simulator import Controller, read

from qp_twist.errors import InvalidInput
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


def grid() -> None:
    """Print the table; in each cell joint moves, straight ones to joints, and to poses."""
    print("| robot | | points per m | off the path, mm | axis, ° | speed, % of limits |")
    print("| :-- | :-- | :-- | :-- | :-- | :-- |")
    with tempfile.TemporaryDirectory() as folder:
        for name, extra in ROBOTS:
            job = job_of(name, extra)
            cells = zip(
                *(cell(job, extra, motion, Path(folder)) for motion in MOTIONS), strict=True
            )
            print(f"| {name} | {extra} | {' | '.join(map(' / '.join, cells))} |", flush=True)


def cell(job: Job, extra: str, motion: str, folder: Path) -> tuple[str, str, str, str]:
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
        return ("–",) * 4
    assert written, check.verdict
    program = read(path.read_text(), job.suffix)
    motion_of = Controller(job.cell, program).run()
    own = [job.cell.model.joint(each).qposadr[0] for each in job.cell.joints]
    for move, at in zip(program.moves[1:], motion_of.corners[1:], strict=True):
        theta = np.degrees(job.cell.signs * motion_of.q[at, own] + job.cell.offsets)
        known = move.data and name in SHEETS
        assert not known or data_of(name, theta) == move.data, "another configuration"
    found = measured(job, motion_of)
    return (
        f"{len(program.moves) / LENGTH:.0f}", f"{1e3 * found.off_path:.3f}",
        f"{np.degrees(found.off_axis):.4f}", f"{100.0 * found.speed:.0f}",
    )  # fmt: skip
