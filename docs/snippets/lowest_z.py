"""How low can the mean of z be along the deburring lap?

The lap of qp_gradient is improved as a whole: at every waypoint the configuration moves along the
one direction n that the task leaves free, by an amount α, all α at once by a quadratic program

    min Σ ½‖W(θ̄ − θ − n α)‖²   s.t. no joint moves more than 3° between waypoints,

after which each waypoint is brought back onto the task. It ends in a local minimum.
"""

import dataclasses

import mink
import numpy as np
import qpsolvers
from scipy import sparse

import qp_twist as qt

LARGEST_STEP = np.radians(3.0)
path = qt.load_task("deburring")
ranges = qt.JointRanges.of(path.model)
task = qt.TwistTask("tool", "site", path.projector)
configuration = mink.Configuration(path.model)


def on_task(q):
    """The configurations moved onto the task, and the free direction at each."""
    q, free = q.copy(), np.empty_like(q)
    for i, waypoint in enumerate(path.waypoints):
        task.set_target(waypoint)
        configuration.update(q[i])
        while np.abs((state := task.state(configuration)).error).max() > 1e-9:
            step = qt.closed_form.minimum_norm(state.jacobian, state.projector, state.error)
            configuration.integrate_inplace(step, 1.0)
        q[i] = configuration.q
        free[i] = np.linalg.svd(state.basis.T @ state.jacobian)[2][-1]
    return q, free


def improved(q, free):
    """One quadratic program over all α; the first waypoint stays."""
    count, joints = q.shape
    H = sparse.diags(((ranges.weight * free) ** 2).sum(axis=1), format="csc")
    c = -(ranges.weight**2 * (ranges.middle - q) * free).sum(axis=1)
    here, following = (np.arange(count - 1)[:, None] + [0, 1]).T
    rows = np.arange((count - 1) * joints)
    change = sparse.csc_matrix(
        (
            np.concatenate([-free[:-1].ravel(), free[1:].ravel()]),
            (np.tile(rows, 2), np.concatenate([here.repeat(joints), following.repeat(joints)])),
        ),
        shape=(len(rows), count),
    )
    now = np.diff(q, axis=0).ravel()
    bounds = np.concatenate([LARGEST_STEP - now, LARGEST_STEP + now])
    alpha = np.full(count, np.radians(20.0))
    alpha[0] = 0.0
    x = qpsolvers.solve_qp(
        H,
        c,
        sparse.vstack([change, -change], format="csc"),
        bounds,
        lb=-alpha,
        ub=alpha,
        solver="proxqp",
        eps_abs=1e-7,
        eps_rel=0.0,
        backend="sparse",
    )
    return on_task(q + x[:, None] * free)


lap = qt.follow(path, "qp_gradient").q
print(f"qp_gradient:              mean z {ranges.centring(lap).mean():.4f}")
q, free = on_task(lap)
before = np.inf
while before - ranges.centring(q).mean() > 1e-6:
    before = ranges.centring(q).mean()
    q, free = improved(q, free)
step = np.degrees(np.abs(np.diff(q, axis=0)).max())
print(
    f"the lap as a whole:       mean z {ranges.centring(q).mean():.4f}, "
    f"largest step {step:.2f}°, smallest margin {ranges.margins(q).min():.3f}"
)

other = dataclasses.replace(path, start=np.radians([92, 3, -38, -29, -44, -47]))
lap = qt.follow(other, "qp_gradient")
print(f"qp_gradient, other start: mean z {lap.z.mean():.4f}")
