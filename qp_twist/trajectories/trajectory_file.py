"""Trajectory files by their suffix: tables, archives, bags, robot programs."""

from __future__ import annotations

import io
import json
import tempfile
from collections.abc import Callable, Collection, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from qp_twist.checks import clause, float_array, path_of
from qp_twist.errors import InvalidInput
from qp_twist.files import of_file, read_bytes, write_atomically
from qp_twist.paths import PathTask
from qp_twist.programs import DOES_NOT_PASS, SUFFIXES, dialect_of
from qp_twist.robots import ControllerJoints
from qp_twist.trajectories import (
    csv_trajectory,
    json_trajectory,
    mcap_trajectory,
    program_trajectory,
)
from qp_twist.trajectories.check import Check, check_trajectory
from qp_twist.trajectories.followed import NotFollowed
from qp_twist.trajectories.linear_moves import LinearMotion
from qp_twist.trajectories.metadata import read_metadata, stating_lift_offs, with_lift_offs
from qp_twist.trajectories.program_writer import ProgramWriter
from qp_twist.trajectories.timed_path import TimedPath

if TYPE_CHECKING:
    from qp_twist.following import Trajectory

_ROUNDS = 12
"""Times at most that a program is written, as its check asks: with less rounding the moves beside
are looked at nearer to the corner, where they may be farther off; and beside joint moves the points
are others."""


def _to_npz(rows: TimedPath) -> bytes:
    """Arrays ``joint_names``, ``q``, ``times``, ``velocities``; ``metadata`` is a JSON text.

    Missing data are left out. ``accelerations`` are there only if the rows have them: they say that
    the joints move on quintics.
    """
    arrays = {"joint_names": np.array(rows.joint_names)}
    for name in ("q", "times", "velocities", "accelerations"):
        values = getattr(rows, name)
        if values is not None:
            arrays[name] = values
    arrays["metadata"] = np.array(json.dumps(rows.metadata, ensure_ascii=False))
    buffer = io.BytesIO()
    np.savez(buffer, **arrays)  # type: ignore[arg-type]
    return buffer.getvalue()


def _from_npz(content: bytes, joint_names: tuple[str, ...] | None) -> TimedPath:
    """The rows of an archive; the names ``positions`` and ``time`` are also supported."""
    try:
        with np.load(io.BytesIO(content), allow_pickle=False) as archive:
            arrays = {name: archive[name] for name in archive.files}
    except Exception as error:  # invalid files raise various errors of zipfile, zlib or NumPy
        raise InvalidInput(f"this is no NumPy archive (.npz): {clause(error)}.") from None

    q, times, velocities, accelerations = (
        next((float_array(name, arrays[name]) for name in names if name in arrays), None)
        for names in (("q", "positions"), ("times", "time"), ("velocities",), ("accelerations",))
    )
    if q is None:
        raise InvalidInput(
            f"there is no array 'q' or 'positions'; there is {', '.join(arrays) or 'nothing'}."
        )
    if "joint_names" in arrays:
        joint_names = tuple(str(name) for name in arrays["joint_names"].ravel())
    elif joint_names is None or q.ndim != 2 or q.shape[1] != len(joint_names):
        raise InvalidInput("there is no array 'joint_names' that says which column is which.")
    metadata = read_metadata(str(arrays.get("metadata", "")))
    return TimedPath(joint_names, q, times, velocities, metadata, accelerations)


_Encode = Callable[[TimedPath], str | bytes]
_Decode = Callable[[bytes, tuple[str, ...] | None], TimedPath]
_FORMATS: dict[str, tuple[_Encode, _Decode]] = {
    ".csv": (csv_trajectory.encode, csv_trajectory.decode),
    ".npz": (_to_npz, _from_npz),
    ".json": (json_trajectory.encode, json_trajectory.decode),
    ".mcap": (mcap_trajectory.encode, mcap_trajectory.decode),
}
ENDINGS = (*_FORMATS, *SUFFIXES)
"""Suffixes of the files that are written and read."""
_LARGEST = 1e5
"""Positions, speeds and accelerations beyond this, in SI units, are mistakes of a file: the fastest
arms make some 10³ rad/s², and 1e5 rad are 16,000 turns."""


def write_trajectory(
    trajectory: Trajectory | TimedPath,
    path: str | Path,
    joints: ControllerJoints | None = None,
) -> Path:
    """Write a trajectory by the suffix of ``path``: a table, an archive, a bag, a robot program.

    What :func:`~qp_twist.time_trajectory` returns is written with its times and, for cubics, its
    velocities; a plain trajectory has rows only. The file is written under a temporary name and
    renamed, so a failure leaves no partial file. A program longer than its controller takes is
    divided; its further files are beside ``path``.

    Args:
        trajectory: The trajectory, or the rows of a file.
        path: A file that ends in ``.csv``, ``.npz``, ``.json``, ``.mcap``, or for a program in
            ``.script`` (URScript), ``.mod`` (RAPID), ``.src`` (KRL) or ``.ls`` (Fanuc).
        joints: For a program: how the controller counts the joints
            (:func:`~qp_twist.trajectories.joints_of`). Without it the trajectory's robot has to be
            a known one.

    Raises:
        InvalidInput: If the suffix is unknown, or the trajectory or robot do not fit a program.
    """
    path = path_of("write_trajectory(…, path)", path)
    run = getattr(trajectory, "trajectory", trajectory)
    task: PathTask | None = getattr(run, "path_task", None)  # rows of a file have none
    return _write(path, _encoded(trajectory, path, _writer(trajectory, path, joints, task)))


def _writer(
    trajectory: Trajectory | TimedPath,
    path: Path,
    joints: ControllerJoints | None,
    task: PathTask | None,
    linear: LinearMotion | None = None,
) -> ProgramWriter | None:
    """What writes a program; ``None`` of other files. Messages name ``path``."""
    rows, dialect = TimedPath.of(trajectory), dialect_of(path)
    if dialect is None:
        return None
    if joints is None:
        joints = program_trajectory.joints_of(task, rows.joint_names)
    with of_file(path):
        return ProgramWriter(rows, dialect, joints, path.stem, task, linear)


def _encoded(
    trajectory: Trajectory | TimedPath, path: Path, writer: ProgramWriter | None
) -> Mapping[str, str | bytes]:
    """The files to write, by name; a program may have several. Messages name ``path``."""
    if writer is None:
        encode, _ = _format(path)
        return {path.name: encode(TimedPath.of(trajectory))}
    with of_file(path):
        return writer.texts()


def _write(path: Path, files: Mapping[str, str | bytes]) -> Path:
    """Write the files, that of this name last: the program in it calls the others."""
    for name, content in reversed(list(files.items())):
        same = Path(name).stem == path.stem
        write_atomically(path if same else path.parent / name, content)
    return path


class CheckedFile(NamedTuple):
    """The check of a file, and whether it was written."""

    check: Check
    written: bool


def write_checked(
    trajectory: Trajectory | TimedPath,
    path: Path,
    path_task: PathTask,
    joints: ControllerJoints | None = None,
    *,
    joint_names: Sequence[str] | None = None,
    force: bool = False,
    linear: LinearMotion | None = None,
) -> CheckedFile:
    """Write a trajectory, read it back and check it; a program that does not pass is not written.

    With ``force`` it is, with a first line at which a controller stops. ``joint_names`` are the
    joints to read back, in this order; ``None``: those of the file. With ``linear``, a program
    moves the tool along the path instead of the joints, without circles if it passes only so. Where
    the task leaves open where the tool lifts off, the trajectory's metadata say it: a program has
    none.

    Raises:
        InvalidInput: As :func:`write_trajectory`.
    """
    calls, dialect = path_task.calls.values(), dialect_of(path)
    metadata = TimedPath.of(trajectory).metadata
    lifted = with_lift_offs(path_task, metadata)
    straight = [] if linear is None or not linear.circles else [linear._replace(circles=False)]
    for motion in (linear, *straight):
        writer = _writer(trajectory, path, joints, lifted, motion)
        for left in reversed(range(_ROUNDS)):
            files = _encoded(trajectory, path, writer)
            try:
                with tempfile.TemporaryDirectory() as folder:
                    file = _write(Path(folder) / path.name, files)
                    rows = read_trajectory(file, joint_names, joints, calls)
            except NotFollowed as refusal:  # by the digits of a pose
                if left and writer is not None and writer.joins([refusal.move]):
                    continue
                raise
            check = check_trajectory(stating_lift_offs(rows, metadata), path_task)
            if check.passes or writer is None or not writer.answers(rows, check):
                break
        if check.passes:
            break
    if dialect is not None and not check.passes:
        if not force:
            return CheckedFile(check, False)
        verdict = "; ".join([*check.problems, *check.sources]).replace("°", "deg")
        verdict = " ".join(verdict.encode("ascii", "replace").decode().split())
        line = f"{DOES_NOT_PASS}: {verdict}"
        files = {name: dialect.stopped(str(text), line) for name, text in files.items()}
    _write(path, files)
    return CheckedFile(check, True)


def read_trajectory(
    path: str | Path,
    joint_names: Sequence[str] | None = None,
    joints: ControllerJoints | None = None,
    calls: Collection[str] = (),
) -> TimedPath:
    """Read a trajectory file of this package or of another tool.

    Args:
        path: A file that ends in ``.csv``, ``.npz``, ``.json`` or ``.mcap``, or a program that ends
            in ``.script``, ``.mod``, ``.src`` or ``.ls``.
        joint_names: The joints to read, in this order. Columns are found by these names; others
            must not be axes that move. Without names every column that is not recognised as
            something else is a joint.
        joints: How the controller of a program counts the joints; required for a program.
        calls: Procedures that a program may call although it does not have them
            (``path_task.calls.values()``).

    Returns:
        The rows, in rad, m and s.

    Raises:
        InvalidInput: If the file cannot be opened or parsed; with the place.
    """
    path = path_of("read_trajectory(path)", path)
    dialect = dialect_of(path)
    if dialect is not None:
        if joints is None:
            raise InvalidInput(
                f"{path}: a program's angles are the controller's; say how it counts the joints "
                "(joints=qp_twist.trajectories.joints_of(…))."
            )
        rows = program_trajectory.decode(path, dialect, joints, calls)
        return rows if joint_names is None else rows.of_joints(joint_names)
    _, decode = _format(path)
    content = read_bytes(path, "trajectory file")
    with of_file(path):
        rows = decode(content, None if joint_names is None else tuple(joint_names))
        _check_numbers(rows)
        return rows if joint_names is None else rows.of_joints(joint_names)


def _check_numbers(rows: TimedPath) -> None:
    """Refuse numbers that no joint has, and times that do not increase, with their row."""
    for name in ("q", "velocities", "accelerations"):
        values = getattr(rows, name)
        if values is not None and (large := np.argwhere(np.abs(values) > _LARGEST)).size:
            row, joint = large[0]
            raise InvalidInput(
                f"{name} of {rows.joint_names[joint]} in row {row + 1} is "
                f"{values[row, joint]:.3g}: no joint moves so; expected at most {_LARGEST:g}, in "
                "SI units."
            )
    if rows.times is not None and (back := np.flatnonzero(np.diff(rows.times) <= 0.0)).size:
        row = int(back[0]) + 2
        raise InvalidInput(
            f"times: row {row} is at {rows.times[row - 1]:.9g} s, row {row - 1} at "
            f"{rows.times[row - 2]:.9g} s; times have to increase. Remove rows that stand twice."
        )


def _format(path: Path) -> tuple[_Encode, _Decode]:
    if path.suffix.lower() not in _FORMATS:
        raise InvalidInput(f"{path}: expected a file that ends in {', '.join(ENDINGS)}.")
    return _FORMATS[path.suffix.lower()]
