"""Joints that MJCF couples (``<equality><joint …/>``), as in grippers, share their limits."""

from __future__ import annotations

from collections.abc import Iterator

import mujoco
import numpy as np

from qp_twist.checks import Array
from qp_twist.errors import InvalidInput


def share_limits(
    model: mujoco.MjModel, lower: Array, upper: Array, acceleration: Array, *speeds: Array
) -> None:
    r"""Tighten limits in place until those of coupled joints are images of one another.

    With :math:`\theta_1 = o + r\,\theta_2` the first joint brakes \|r\| times as hard as the
    second. Unless their limits are in that ratio, the one may be free to move where the other
    could not stop in time; with it a velocity that one box allows, the other allows as well.

    Args:
        model: The robot; of its equality constraints those that are active at first.
        lower: θ_min, rad or m, (nv,).
        upper: θ_max, (nv,).
        acceleration: Largest acceleration, rad/s² or m/s², (nv,); ``inf`` where there is none.
        speeds: Other limits in the ratio \|r\|, each (nv,).

    Raises:
        InvalidInput: If a joint with an acceleration limit is in a coupling that is not linear, or
            coupled ranges have no position in common.
    """
    couplings = list(_linear_couplings(model, acceleration))
    for _ in couplings:  # as many passes reach the far end of any chain
        for one, other, o, r in couplings:
            for a, b, offset, ratio in ((one, other, o, r), (other, one, -o / r, 1.0 / r)):
                image = sorted((offset + ratio * lower[b], offset + ratio * upper[b]))
                lower[a], upper[a] = max(lower[a], image[0]), min(upper[a], image[1])
                for limit in (acceleration, *speeds):
                    limit[a] = min(limit[a], abs(ratio) * limit[b])
            if lower[one] > upper[one]:
                raise InvalidInput(
                    f"{_names(model, one, other)} are coupled, but their ranges have no position "
                    "in common; check the scene's <equality>."
                )


def _linear_couplings(
    model: mujoco.MjModel, acceleration: Array
) -> Iterator[tuple[int, int, float, float]]:
    """Degrees of freedom 1 and 2, o and r of each coupling θ₁ = o + r θ₂."""
    coupled = (model.eq_type == mujoco.mjtEq.mjEQ_JOINT) & (model.eq_active0 != 0)
    for index in np.flatnonzero(coupled & (model.eq_obj2id >= 0)):
        joints = int(model.eq_obj1id[index]), int(model.eq_obj2id[index])
        one, other = (int(model.jnt_dofadr[joint]) for joint in joints)
        # MuJoCo's polynomial is in the displacements from the reference positions.
        start, other_start = (float(model.qpos0[model.jnt_qposadr[joint]]) for joint in joints)
        constant, ratio, *rest = (float(c) for c in model.eq_data[index, :5])
        if any(rest):
            if np.isfinite(acceleration[[one, other]]).any():
                raise InvalidInput(
                    f"acceleration: {_names(model, one, other)} are coupled by a polynomial that "
                    "is not linear, so that no fixed limits let both brake together; give them no "
                    "acceleration limits."
                )
        elif ratio != 0.0:
            yield one, other, start + constant - ratio * other_start, ratio


def _names(model: mujoco.MjModel, *dofs: int) -> str:
    names = (repr(model.joint(int(model.dof_jntid[dof])).name) for dof in dofs)
    return f"joints {' and '.join(names)}"
