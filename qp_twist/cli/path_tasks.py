"""What commands about a task share: loading it, its methods, and how its programs are read."""

from __future__ import annotations

import re
import sys
import warnings
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

from qp_twist.checks import one_of
from qp_twist.cli.app import quiet
from qp_twist.cli.progress import note_compiling
from qp_twist.errors import InvalidInput
from qp_twist.kinematics import JointRanges
from qp_twist.paths import METHODS, PathTask, check_method, load_task
from qp_twist.programs import SUFFIXES, dialect_of
from qp_twist.robots import ControllerJoints
from qp_twist.trajectories import Check, TimedPath, joints_of, read_trajectory


def load(
    task: str,
    path: Path | None = None,
    feed: str | None = None,
    max_dip: float | None = None,
    calls: str | None = None,
) -> PathTask:
    """Load a task; print on standard error what its robot's and toolpath's files leave out.

    A note follows there if the command has to compile kernels. ``feed`` and ``max_dip`` take the
    place of ``mode`` and ``max_dip`` of the file's [feed], ``calls`` that of its [program].
    """
    if "numba" in sys.modules:  # a command that follows or plans loads it
        note_compiling()
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        path_task = load_task(task, path=path)
    if feed is not None or max_dip is not None:
        constant = path_task.constant_speed if feed is None else _is_constant(feed)
        most = path_task.max_dip if max_dip is None else max_dip
        path_task = replace(path_task, constant_speed=constant, max_dip=most)
    if calls is not None:
        path_task = replace(path_task, calls=dict(map(_call, filter(str.strip, calls.split(",")))))
    if path_task.clearances:  # their distances are kernels, too
        note_compiling()
    notes = [str(warning.message) for warning in caught]
    if path_task.toolpath is not None:
        notes += path_task.toolpath.notes
    if not quiet.get():
        for note in notes:
            print(f"note: {note}", file=sys.stderr)
    return path_task


def _call(text: str) -> tuple[str, str]:
    """A word and its procedure, of --calls."""
    word, _, name = text.partition("=")
    return word.strip(), name.strip()


def _is_constant(feed: str) -> bool:
    return one_of("--feed", feed, ("fastest", "constant")) == "constant"


def with_secondary(
    path_task: PathTask, methods: Sequence[str], gain: float | None, weight: str | None
) -> PathTask:
    """The task with --gain and --weight in place of the settings of the methods that use them."""
    given = {"gain": gain, "weight": weight}
    options = {name: value for name, value in given.items() if value is not None}
    if not options:
        return path_task
    from qp_twist.following import with_options  # and all planners

    return with_options(path_task, methods, options, " and ".join(f"--{name}" for name in options))


def method_names(path_task: PathTask, methods: str | None) -> list[str]:
    """The methods named in an argument; without it all applicable ones."""
    if methods is None:
        return path_task.method_names()
    names = [name.strip() for name in methods.split(",") if name.strip()]
    if not names:
        raise InvalidInput(f"--methods {methods!r}: no name in it; known: {', '.join(METHODS)}.")
    return [check_method(name) for name in names]


def program_joints(
    path: Path, path_task: PathTask, robot: str | None, as_modelled: bool, external: str | None
) -> ControllerJoints | None:
    """How the controller counts the joints, for a file that is a program; ``None`` for others."""
    if dialect_of(path) is None:
        if robot is not None or as_modelled or external:
            raise InvalidInput(
                f"{path}: --robot, --as-modelled and --external are for programs "
                f"({', '.join(SUFFIXES)}); "
                "other files have the model's joints."
            )
        return None
    names = JointRanges.of(path_task.shown.model).names
    return joints_of(
        path_task, names, robot=robot, as_modelled=as_modelled, external=equations(external)
    )


def equations(external: str | None) -> list[str]:
    """The equations of --external."""
    return [
        re.sub(r"\s*=\s*", " = ", text.strip())
        for text in (external or "").split(",")
        if text.strip()
    ]


def read_motion(
    trajectory: Path,
    path_task: PathTask,
    robot: str | None,
    as_modelled: bool,
    external: str | None,
) -> TimedPath:
    """A trajectory file or robot program of a task."""
    joints = program_joints(trajectory, path_task, robot, as_modelled, external)
    names = JointRanges.of(path_task.shown.model).names
    return read_trajectory(trajectory, names, joints, path_task.calls.values())


def failure(file: Path, check: Check, written: bool) -> str:
    """The verdict on a file that does not pass, and whether it was written."""
    if dialect_of(file) is None:
        return f"{file}: {check.verdict}"
    how = "written with a first line that stops a controller (--force)"
    if not written:
        older = "; the file of this name is an older one" if file.exists() else ""
        how = f"the program is not written (--force writes it, to be seen only){older}"
    return f"{file}: {check.verdict}; {how}"
