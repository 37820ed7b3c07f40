"""mink's limits on single joints as bounds, computed without evaluating their rows."""

from __future__ import annotations

import operator
from typing import Any, NamedTuple
from weakref import WeakKeyDictionary

import mink
import mujoco
import numpy as np

from qp_twist.checks import Array, Indices
from qp_twist.constraints.box import Box, no_box

_joints: WeakKeyDictionary[mink.Limit, tuple[tuple[object, ...], MinkRange]] = WeakKeyDictionary()
_speeds: WeakKeyDictionary[mink.Limit, tuple[tuple[bytes, bytes], Box]] = WeakKeyDictionary()
_of_models: WeakKeyDictionary[mujoco.MjModel, tuple[bytes, MinkRange]] = WeakKeyDictionary()


def is_mink_box(limit: Any) -> bool:
    """Whether a limit is one of mink's on single joints.

    A limited ball joint does not count: its row turns with the joint.
    """
    if type(limit) is mink.ConfigurationLimit:
        return len(limit._ball_qposadr) == 0
    return type(limit) is mink.VelocityLimit


def mink_box(limit: Any, configuration: mink.Configuration, dt: float) -> Box | None:
    r"""Bounds of such a limit on :math:`\dot{\mathbf q}`, rad/s or m/s.

    With mink's gain k they are :math:`k(\theta_{min} - \theta)/dt` and
    :math:`k(\theta_{max} - \theta)/dt`, or :math:`\mp v_{max}`. ``None`` for any other limit.
    """
    if not is_mink_box(limit):
        return None
    model = configuration.model
    if isinstance(limit, mink.VelocityLimit):
        return speeds_of(limit, model.nv)
    known = range_of(limit, model)
    if known is None:
        return None
    lower, upper = np.full(model.nv, -np.inf), np.full(model.nv, np.inf)
    at, share = known.addresses, known.gain / dt
    q = configuration.data.qpos[at]
    lower[known.dofs] = share * (known.lower[at] - q)
    upper[known.dofs] = share * (known.upper[at] - q)
    return Box("position", lower, upper)


def qpos_of(limit: mink.ConfigurationLimit) -> Indices:
    """Index in q of each joint of the limit."""
    return _joints_of(limit).addresses


class MinkRange(NamedTuple):
    """Bounds of a :class:`mink.ConfigurationLimit`, ball joints included, without its rows."""

    lower: Array
    """θ_min, (nq,)."""
    upper: Array
    """θ_max, (nq,)."""
    gain: float
    addresses: Indices
    """Indices in q of the joints that have a range, (k,)."""
    dofs: Indices
    """Their degrees of freedom, (k,)."""
    ball_angles: Array
    """φ_max of the limited ball joints, rad."""
    ball_addresses: Indices
    """Indices of their quaternions in q."""
    ball_dofs: Indices
    """First degree of freedom of each."""

    @property
    def first_ball_row(self) -> int:
        """Index of the first ball joint's row in the limit, after two rows for each other joint."""
        return 2 * len(self.dofs)


def range_of(limit: mink.ConfigurationLimit, model: mujoco.MjModel) -> MinkRange | None:
    """The range of a limit; ``None`` if it is for another model, or not as mink builds it.

    The bounds are read in each call. The indices of its joints are cached until the arrays that
    contain them are replaced.
    """
    known, own = _joints_of(limit), limit.model
    if (own.nq, own.nv) != (model.nq, model.nv):
        return None
    if (limit.projection_matrix is None) != (len(known.dofs) == 0):
        return None
    numbers: tuple[Any, ...] = limit.lower, limit.upper, limit._ball_max_angle
    for array, length in zip(numbers, (model.nq, model.nq, len(known.ball_dofs)), strict=True):
        if (
            not isinstance(array, np.ndarray)
            or array.dtype != np.float64
            or array.shape != (length,)
        ):
            return None
    lower, upper, angles = numbers
    return known._replace(lower=lower, upper=upper, gain=float(limit.gain), ball_angles=angles)


def _joints_of(limit: mink.ConfigurationLimit) -> MinkRange:
    """The joints of a limit, without its bounds, read again if the arrays are replaced."""
    kept, model = _joints.get(limit), limit.model
    source = limit.indices, model, limit._ball_qposadr, limit._ball_dofadr
    if kept is None or any(map(operator.is_not, kept[0], source)):
        dofs, none = np.array(limit.indices, dtype=np.intp), np.zeros(0)
        addresses = model.jnt_qposadr[model.dof_jntid[dofs]].astype(np.intp)
        balls = np.array([limit._ball_qposadr, limit._ball_dofadr], dtype=np.intp)
        made = MinkRange(none, none, 1.0, addresses, dofs, none, *balls)
        kept = _joints[limit] = source, made
    return kept[1]


def default_range(model: mujoco.MjModel) -> MinkRange:
    """The range of ``mink.ConfigurationLimit(model)``, cached while the model's ranges stay.

    mink builds one in each call. The ranges, and which joints have one, are compared; joints and
    their order cannot change in a model that is in use.
    """
    ranges = model.jnt_range.tobytes() + model.jnt_limited.tobytes()
    kept = _of_models.get(model)
    if kept is None or kept[0] != ranges:
        made = range_of(mink.ConfigurationLimit(model), model)
        assert made is not None
        # Only arrays: a reference to the model would keep it alive for ever.
        kept = _of_models[model] = ranges, made
    return kept[1]


def speeds_of(limit: mink.VelocityLimit, nv: int) -> Box | None:
    """The bounds of a velocity limit; ``None`` if it is for another model."""
    if limit.projection_matrix is None:
        return no_box("velocity", nv)
    state = limit.limit.tobytes(), limit.indices.tobytes()
    kept = _speeds.get(limit)
    if kept is None or kept[0] != state:
        upper = np.full(limit.projection_matrix.shape[1], np.inf)
        upper[limit.indices] = limit.limit
        kept = _speeds[limit] = state, Box("velocity", -upper, upper)
    return kept[1] if len(kept[1].lower) == nv else None
