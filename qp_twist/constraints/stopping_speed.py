"""How fast a joint may approach a limit: as fast as it can still brake."""

from __future__ import annotations

import numpy as np

from qp_twist.checks import Array
from qp_twist.kernel.constants import BRAKING


def stopping_speed(room: Array, acceleration: Array, dt: float) -> Array:
    r"""Largest speed towards a limit from which braking stops in time, in discrete time, exactly.

    .. math::

        v = \frac{d}{(N + 1)\,\Delta t} + \frac{N a\,\Delta t}{2}, \qquad
        N = \Bigl\lfloor \tfrac12 \bigl(\sqrt{1 + 8 d/(a\Delta t^2)} - 1\bigr) \Bigr\rfloor

    (:doc:`/proofs`). Arguments are the room d ≥ 0, rad or m, ``inf`` without a limit; a > 0, rad/s²
    or m/s², ``inf`` without a limit, then v = d/dt; and the length of each step, s.
    """
    if not np.count_nonzero(acceleration < np.inf):
        return room / dt
    braking = acceleration * dt
    with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
        steps = np.floor((np.sqrt(1.0 + 8.0 * room / (braking * dt)) - 1.0) / 2.0)
        speed = room / ((steps + 1.0) * dt) + 0.5 * steps * braking
        # 0 · ∞ without an acceleration limit, ∞/∞ without a position limit.
        result: Array = np.where(np.isnan(speed), room / dt, speed)
    return result


def stopping_share(motion: Array, acceleration: Array, dt: float) -> float:
    r"""Share of a displacement that this step may make so that the joints can stop at its end.

    .. math::

        s_b = \min\bigl(1,\ dt\,v(1, \ddot p)\bigr),\qquad
        \ddot p = \eta\,\min_i \frac{a_i}{|\Delta q_i|}

    with v(d, a) the :func:`stopping_speed`: the task's displacement is 1, and along it the joints
    brake by at most p̈, with η = ``BRAKING``. ``motion`` (n,) is the Δq that would remove the task's
    error, rad or m; ``acceleration`` (n,) is ∞ without a limit.
    """
    with np.errstate(divide="ignore"):
        braking = BRAKING * float(np.min(acceleration / np.abs(motion), initial=np.inf))
    if braking == np.inf:
        return 1.0
    return min(1.0, dt * float(stopping_speed(np.array(1.0), np.array(braking), dt)))
