"""Steps of a controller one after the other, and what a walk shows."""

from collections.abc import Callable

import mink
import numpy as np
import numpy.typing as npt

import qp_twist as qt

Array = npt.NDArray[np.float64]


def walk(
    controller: qt.Controller,
    configuration: mink.Configuration,
    steps: int,
    dt: float,
    feed: Callable[[float], object] = lambda _: None,
) -> tuple[Array, Array]:
    """Configurations after each step and velocities of it, (steps, nq) and (steps, nv).

    ``feed(t)`` sets targets before the step at time t, s.
    """
    q, velocities = [], []
    for k in range(steps):
        feed(k * dt)
        velocities.append(controller.step(configuration, dt).velocity.copy())
        configuration.integrate_inplace(velocities[-1], dt)
        q.append(configuration.q.copy())
    return np.array(q), np.array(velocities)


def reversals(velocities: npt.ArrayLike) -> int:
    """How often a joint turns round from one step to the next, faster than 0.3 rad/s."""
    v = np.asarray(velocities)
    turned = (v[1:] * v[:-1] < 0.0) & (np.minimum(np.abs(v[1:]), np.abs(v[:-1])) > 0.3)
    return int(turned.sum())
