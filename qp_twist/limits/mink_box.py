"""mink's limits on single joints as bounds: what they state is known without asking them."""

from __future__ import annotations

from typing import Any
from weakref import WeakKeyDictionary

import mink
import mujoco
import numpy as np

from qp_twist.checks import Indices
from qp_twist.limits.box_limit import Box

_addresses: WeakKeyDictionary[mink.Limit, Indices] = WeakKeyDictionary()
_of_models: WeakKeyDictionary[mujoco.MjModel, tuple[bytes, mink.ConfigurationLimit]] = (
    WeakKeyDictionary()
)


def is_mink_box(limit: Any) -> bool:
    """Whether it is a limit of mink's on single joints.

    A limited ball joint is none: its row turns with the joint.
    """
    if type(limit) is mink.ConfigurationLimit:
        return len(limit._ball_qposadr) == 0
    return type(limit) is mink.VelocityLimit


def mink_box(limit: Any, configuration: mink.Configuration, dt: float) -> Box:
    r"""The bounds on :math:`\dot{\mathbf q}` that such a limit states, rad/s or m/s.

    With mink's gain k they are :math:`k(\theta_{min} - \theta)/dt` and
    :math:`k(\theta_{max} - \theta)/dt`, or :math:`\mp v_{max}`.
    """
    nv = configuration.model.nv
    lower, upper = np.full(nv, -np.inf), np.full(nv, np.inf)
    kind = "velocity" if isinstance(limit, mink.VelocityLimit) else "position"
    if limit.projection_matrix is not None:
        dofs = limit.indices
        if isinstance(limit, mink.VelocityLimit):
            lower[dofs], upper[dofs] = -limit.limit, limit.limit
        else:
            qpos, share = qpos_of(limit), limit.gain / dt
            q = configuration.q[qpos]
            lower[dofs] = share * (limit.lower[qpos] - q)
            upper[dofs] = share * (limit.upper[qpos] - q)
    return Box(kind, lower, upper)


def qpos_of(limit: mink.ConfigurationLimit) -> Indices:
    """Address in q of each joint that a limit is about."""
    found = _addresses.get(limit)
    if found is None:
        model = limit.model
        found = _addresses[limit] = model.jnt_qposadr[model.dof_jntid[limit.indices]]
    return found


def default_limit(model: mujoco.MjModel) -> mink.ConfigurationLimit:
    """``mink.ConfigurationLimit(model)``, made once while the model's ranges stay."""
    ranges = model.jnt_range.tobytes() + model.jnt_limited.tobytes()
    kept = _of_models.get(model)
    if kept is None or kept[0] != ranges:
        kept = _of_models[model] = ranges, mink.ConfigurationLimit(model)
    return kept[1]
