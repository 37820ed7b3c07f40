"""Bounds of mink's limits on single joints, read by machine code in a third of mink's time."""

from __future__ import annotations

import weakref
from collections.abc import Callable
from functools import cache
from typing import Any, NamedTuple

import mink
import mujoco
import numpy as np

from qp_twist.checks import Array, Indices
from qp_twist.constraints import has_plain_rows, refuse_unknown_attributes


class _Known(NamedTuple):
    """The arrays of a limit that machine code can read, until it has others.

    Their numbers are read anew at every step; while they are kept here, they cannot be resized.
    """

    given: tuple[Any, ...]
    of: tuple[int, ...]
    """The ``id`` of each."""
    model: weakref.ref[mujoco.MjModel]
    qpos: Indices
    """Where each degree of freedom is in q, (nv,), of balls and free joints their first place; of a
    ``VelocityLimit`` none, (0,)."""


_NO_PLACES = np.zeros(0, np.int64)
_known: weakref.WeakKeyDictionary[mink.Limit, _Known] = weakref.WeakKeyDictionary()


def add_bounds(limit: Any, configuration: mink.Configuration, dt: float, box: Array) -> bool:
    """Narrow the bounds of the velocity, ``box`` (2, nv), by a limit of mink's on single joints.

    Returned is whether it is one, with matrix and arrays as mink made them; any other's rows have
    to be asked for.
    """
    ranges = type(limit) is mink.ConfigurationLimit
    given: tuple[Any, ...]
    if ranges:
        given = limit.lower, limit.upper, limit.indices, limit.projection_matrix
    elif type(limit) is mink.VelocityLimit:
        given = limit.limit, limit.limit, limit.indices, limit.projection_matrix
    else:
        return False
    refuse_unknown_attributes(limit)
    known = _known.get(limit)
    if known is None or known.of != (*map(id, given),) or known.model() is not configuration.model:
        if not _are_readable(limit, configuration, *given):
            return False
        own = configuration.model
        known = _known[limit] = _Known(
            given, (*map(id, given),), weakref.ref(own),
            own.jnt_qposadr[own.dof_jntid].astype(np.int64) if ranges else _NO_PLACES,
        )  # fmt: skip
    lower, upper, dofs, matrix = given
    gain = limit.gain if ranges else 1.0
    q = configuration.data.qpos
    return bool(_machine_code()(q, lower, upper, known.qpos, dofs, matrix, gain, dt, box))


def _are_readable(limit: Any, configuration: mink.Configuration, *given: Any) -> bool:
    """Whether the arrays have the types and shapes with which machine code reads them."""
    if not has_plain_rows(limit, configuration):
        return False
    lower, upper, dofs, matrix = given
    nv, nq = configuration.model.nv, configuration.model.nq
    ends = nq if type(limit) is mink.ConfigurationLimit else np.size(dofs)
    wanted = ((lower, (ends,)), (upper, (ends,)), (dofs, (np.size(dofs),)))
    return (
        all(type(array) is np.ndarray for array in given)
        and all(array.flags.c_contiguous and array.flags.aligned for array in given)
        and all(array.shape == shape for array, shape in (*wanted, (matrix, (np.size(dofs), nv))))
        and lower.dtype == upper.dtype == matrix.dtype == np.float64
        and dofs.dtype == np.int64
    )


@cache
def _machine_code() -> Callable[..., Any]:
    """``kernel.row_program.add_bounds``."""
    from qp_twist.kernel.compiling import bound  # with numba, which takes half a second
    from qp_twist.kernel.row_program import add_bounds

    one, some, row = np.zeros(1), np.zeros(1, np.int64), np.zeros((1, 1))
    return bound(add_bounds, one, one, one, some, some, row, 1.0, 1.0, row)
