"""Trajectories as NumPy archives."""

from __future__ import annotations

import io
import json

import numpy as np

from qp_twist.checks import Array, float_array
from qp_twist.errors import InvalidInput
from qp_twist.exchange.joint_rows import JointRows
from qp_twist.exchange.metadata import read_metadata


def encode(rows: JointRows) -> bytes:
    """Arrays ``joint_names``, ``q``, ``times``, ``velocities``; ``metadata`` is a JSON text.

    What there is not is left out. With velocities ``accelerations`` stands there too, for readers
    in a hurry: q̈ of the piece that begins at each row.
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


def decode(content: bytes, joint_names: tuple[str, ...] | None) -> JointRows:
    """The rows of an archive; ``positions`` and ``time`` are understood as well."""
    try:
        with np.load(io.BytesIO(content), allow_pickle=False) as archive:
            arrays = {name: archive[name] for name in archive.files}
    except Exception as error:  # what is broken fails in zipfile, zlib or NumPy, each in its way
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
