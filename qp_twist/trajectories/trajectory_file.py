"""Trajectory files by their suffix; NumPy archives."""

from __future__ import annotations

import io
import json
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np

from qp_twist.checks import Array, float_array
from qp_twist.errors import InvalidInput
from qp_twist.files import of_file, read_bytes, write_atomically
from qp_twist.following import Trajectory
from qp_twist.trajectories import csv_trajectory, json_trajectory
from qp_twist.trajectories.joint_rows import JointRows
from qp_twist.trajectories.metadata import read_metadata
from qp_twist.trajectories.time_trajectory import TimedTrajectory


class _Format(NamedTuple):
    encode: Callable[[JointRows], str | bytes]
    decode: Callable[[bytes, tuple[str, ...] | None], JointRows]


def _to_npz(rows: JointRows) -> bytes:
    """Arrays ``joint_names``, ``q``, ``times``, ``velocities``; ``metadata`` is a JSON text.

    Missing data are left out. With velocities there is also ``accelerations``, for convenience: q̈
    of the piece that begins at each row.
    """
    arrays = {"joint_names": np.array(rows.joint_names), "q": rows.q}
    if rows.times is not None:
        arrays["times"] = rows.times
    if rows.times is not None and rows.velocities is not None:
        arrays["velocities"] = rows.velocities
        arrays["accelerations"] = rows.motion().at(rows.times).accelerations
    arrays["metadata"] = np.array(json.dumps(rows.metadata, ensure_ascii=False))
    buffer = io.BytesIO()
    np.savez(buffer, **arrays)  # type: ignore[arg-type]
    return buffer.getvalue()


def _from_npz(content: bytes, joint_names: tuple[str, ...] | None) -> JointRows:
    """The rows of an archive; the names ``positions`` and ``time`` are also supported."""
    try:
        with np.load(io.BytesIO(content), allow_pickle=False) as archive:
            arrays = {name: archive[name] for name in archive.files}
    except Exception as error:  # invalid files raise various errors of zipfile, zlib or NumPy
        raise InvalidInput(f"this is no NumPy archive (.npz): {error}") from None

    def found(*names: str) -> Array | None:
        for name in names:
            if name in arrays:
                return float_array(name, arrays[name])
        return None

    q = found("q", "positions")
    if q is None:
        raise InvalidInput(
            f"there is no array 'q' or 'positions'; there is {', '.join(arrays) or 'nothing'}."
        )
    if "joint_names" in arrays:
        names = tuple(str(name) for name in arrays["joint_names"].ravel())
    elif joint_names is not None and q.ndim == 2 and q.shape[1] == len(joint_names):
        names = joint_names
    else:
        raise InvalidInput("there is no array 'joint_names' that says which column is which.")
    metadata = read_metadata(str(arrays.get("metadata", "")))
    return JointRows(names, q, found("times", "time"), found("velocities"), metadata)


_FORMATS = {
    ".csv": _Format(csv_trajectory.encode, csv_trajectory.decode),
    ".npz": _Format(_to_npz, _from_npz),
    ".json": _Format(json_trajectory.encode, json_trajectory.decode),
}
ENDINGS = tuple(_FORMATS)
"""Suffixes of the files that are written and read."""


def write_trajectory(trajectory: Trajectory | TimedTrajectory, path: str | Path) -> Path:
    """Write a trajectory as CSV, NPZ or JSON, by the suffix of ``path``.

    A :class:`~qp_twist.TimedTrajectory` is written with its times and, for cubics, its velocities;
    a plain trajectory has rows only. The file is written under a temporary name and renamed, so a
    failure leaves no partial file.

    Raises:
        InvalidInput: If the suffix is unknown.
    """
    path = Path(path)
    return write_atomically(path, _format(path).encode(JointRows.of(trajectory)))


def read_trajectory(path: str | Path, joint_names: Sequence[str] | None = None) -> JointRows:
    """Read a trajectory file of this package or of another tool.

    Args:
        path: A file that ends in ``.csv``, ``.npz`` or ``.json``.
        joint_names: The joints to read, in this order. Columns are found by these names; others are
            ignored. Without names every column that is not recognised as something else is a joint.

    Returns:
        The rows, in rad, m and s.

    Raises:
        InvalidInput: If the file cannot be opened or parsed; with the place.
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
