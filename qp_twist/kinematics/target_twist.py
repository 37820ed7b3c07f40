"""The twist of a target from its poses."""

from __future__ import annotations

import mink
import numpy as np

from qp_twist.checks import Array, finite_array, instance, number


def target_twist(before: mink.SE3, now: mink.SE3, dt: float) -> Array:
    r"""Twist (6,) that moves a target from one pose to another in a time, for its feed-forward.

    .. math::

        \mathbf v = (\mathbf p - \mathbf p_{before})/dt, \qquad
        \boldsymbol\omega = \log(\mathbf R\mathbf R_{before}^T)/dt

    (linear, angular), in the axes of the poses, reference point the target's origin, m/s and rad/s.
    For a conveyor with a known motion, use its poses now and at the end of the step; for a tracked
    part, its last two poses.

    Raises:
        InvalidInput: If a pose is no ``mink.SE3`` or dt ≤ 0.

    Example:
        >>> import mink, numpy as np, qp_twist as qt
        >>> a, b = mink.SE3.identity(), mink.SE3.from_translation(np.array([0.001, 0.0, 0.0]))
        >>> qt.target_twist(a, b, 0.01)
        array([0.1, 0. , 0. , 0. , 0. , 0. ])
    """
    instance("target_twist(before, …)", before, mink.SE3)
    instance("target_twist(…, now)", now, mink.SE3)
    dt = number("dt", dt, above=0.0)
    for name, pose in (("before", before), ("now", now)):
        finite_array(f"target_twist: {name}", pose.wxyz_xyz, (7,))
    linear = now.translation() - before.translation()
    angular = (now.rotation() @ before.rotation().inverse()).log()
    return np.concatenate([linear, angular]) / dt
