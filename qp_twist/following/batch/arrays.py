"""Rigid motions as arrays, and their rows on threads."""

from __future__ import annotations

import os
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from typing import Any, cast

import mink
import numpy as np
import numpy.typing as npt

from qp_twist.checks import Array, finite_array, whole_number
from qp_twist.errors import InvalidInput

_MOST = 1024
_AT_A_TIME = 4
"""Number of parts per thread: a thread with easy rows processes more of them."""


def shared(rows: int, do: Callable[[slice], None], threads: int | None) -> None:
    """Call ``do`` for slices that cover all rows, on some threads; by default on all cores.

    The kernels release the interpreter lock.
    """
    workers = os.cpu_count() or 1
    if threads is not None:
        workers = min(whole_number("threads", threads, at_least=1), _MOST)
    size = max(1, -(-rows // (_AT_A_TIME * workers)))
    with ThreadPoolExecutor(workers) as pool:
        list(pool.map(do, [slice(first, first + size) for first in range(0, rows, size)]))


@np.errstate(over="ignore", invalid="ignore")  # an overflow is not a rotation
def rigid_motions(name: str, motions: Sequence[mink.SE3] | npt.ArrayLike) -> Array:
    """Rotations (9), row by row, and translations (3), (K, 12), of SE3 or matrices (K, 4, 4).

    Raises:
        InvalidInput: If one of them is not a rigid motion, with the ``name`` of the argument.
    """
    if isinstance(motions, (list, tuple)) and all(isinstance(m, mink.SE3) for m in motions):
        matrices = np.array([m.as_matrix() for m in motions]).reshape(-1, 4, 4)
    else:
        matrices = finite_array(name, cast(Any, motions), (None, 4, 4))
    turns = matrices[:, :3, :3]
    off = np.abs(matrices[:, 3] - [0.0, 0.0, 0.0, 1.0]).max(axis=1, initial=0.0)
    product = np.einsum("kij,klj->kil", turns, turns) - np.eye(3)
    off = np.maximum(off, np.abs(product).max(axis=(1, 2), initial=0.0))
    wrong = ~(off <= 1e-6) | ~(np.linalg.det(turns) > 0.0)
    if wrong.any():
        raise InvalidInput(
            f"{name}: number {int(np.argmax(wrong))} is no rigid motion: a rotation and a "
            "translation above a row 0, 0, 0, 1."
        )
    return np.hstack([turns.reshape(-1, 9), matrices[:, :3, 3]])


def pose_of(motion: Array) -> mink.SE3:
    """The pose of rotation (9) and translation (3)."""
    rotation = mink.SO3.from_matrix(motion[:9].reshape(3, 3))
    return mink.SE3.from_rotation_and_translation(rotation, motion[9:12])
