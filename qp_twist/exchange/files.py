"""Trajectory files by their ending."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import NamedTuple

from qp_twist.errors import InvalidInput
from qp_twist.exchange import csv_file, json_file, npz_file
from qp_twist.exchange.joint_rows import JointRows
from qp_twist.files import read_bytes, write_atomically
from qp_twist.following import Trajectory
from qp_twist.tables import of_file
from qp_twist.timing import TimedTrajectory


class _Format(NamedTuple):
    encode: Callable[[JointRows], str | bytes]
    decode: Callable[[bytes, tuple[str, ...] | None], JointRows]


_FORMATS = {
    ".csv": _Format(csv_file.encode, csv_file.decode),
    ".npz": _Format(npz_file.encode, npz_file.decode),
    ".json": _Format(json_file.encode, json_file.decode),
}
ENDINGS = tuple(_FORMATS)
"""The endings of the files that are written and read."""


def write_trajectory(trajectory: Trajectory | TimedTrajectory, path: str | Path) -> Path:
    """Write a trajectory as CSV, NPZ or JSON, whichever ``path`` ends in.

    A :class:`~qp_twist.TimedTrajectory` is written with its times and, where its joints move on
    cubics, its velocities. A plain trajectory has rows only. The file is written beside its place
    and renamed, so a failure leaves nothing half-written.

    Raises:
        InvalidInput: If the ending is another.
    """
    path = Path(path)
    return write_atomically(path, _format(path).encode(JointRows.of(trajectory)))


def read_trajectory(path: str | Path, joint_names: Sequence[str] | None = None) -> JointRows:
    """Read a trajectory file, one of ours or of another tool.

    Args:
        path: A file that ends in ``.csv``, ``.npz`` or ``.json``.
        joint_names: The joints that are wanted, in this order. Columns are found by these names,
            in any order, and others are left out; without names every column that is not known for
            something else is a joint.

    Returns:
        The rows, in rad, m and s.

    Raises:
        InvalidInput: If the file cannot be opened or understood; the message says where.
    """
    path = Path(path)
    form = _format(path)
    content = read_bytes(path, "trajectory file")
    with of_file(path):
        rows = form.decode(content, None if joint_names is None else tuple(joint_names))
        return rows if joint_names is None else rows.of_joints(joint_names)


def _format(path: Path) -> _Format:
    if path.suffix.lower() not in _FORMATS:
        raise InvalidInput(f"{path}: expected a file that ends in {', '.join(ENDINGS)}.")
    return _FORMATS[path.suffix.lower()]
