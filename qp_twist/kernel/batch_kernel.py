"""Independent single steps of many configurations, compiled."""

from __future__ import annotations

from qp_twist.kernel.arm_kernel import pose_and_jacobian
from qp_twist.kernel.bounds import MOTION
from qp_twist.kernel.compiling import kernel
from qp_twist.kernel.edge_step import edge_step
from qp_twist.kernel.step_kernel import RAISE, read_step, step
from qp_twist.kernel.verified_program import AT_THE_EDGE, INFEASIBLE, REFUSED


@kernel
def steps(
    arms, floats, integers, q, before, targets, dt, use_secondary, twist_space, velocities, scales,
    done,
):  # fmt: skip
    """Compute a controller's step from each row of q (K, nq); for the arrays see ``step_record``.

    Args:
        arms: The chain of each task's frame.
        floats: The arrays of one step; overwritten.
        integers: The same.
        q: Configurations, (K, nq).
        before: Joint velocities that acceleration limits refer to, (K, nv); or (0, nv), those in
            the tables of the limits.
        targets: R_d (9), p_d (3) and twist (6) of each task, (K, T, 18).
        dt: Length of the steps, s.
        use_secondary: Whether the secondary acts.
        twist_space: ``None`` for the joint-space cost.
        velocities: Result, (K, nv).
        scales: Result, scale s of the tasks' speed, (K,).
        done: Result, whether each step is verified, (K,).
    """
    s = read_step(floats, integers, integers)
    g, w = s.inputs, s.program
    g.jacobians[:] = 0.0
    for k in range(len(q)):
        for task in range(len(g.kinds)):
            pose_and_jacobian(arms[task], q[k], g.poses[task], g.jacobians[task])
            for i in range(18):
                g.targets[task, i] = targets[k, task, i]
        for index in range(len(g.types) if len(before) > 0 else 0):
            if g.types[index] == MOTION:
                for dof in range(before.shape[1]):
                    g.limits[index, dof, 6] = before[k, dof]
        status = step(g, w, q[k], dt, use_secondary, twist_space)
        if status in (AT_THE_EDGE, INFEASIBLE):
            is_infeasible, status = status == INFEASIBLE, REFUSED
            if g.settings.infeasible != RAISE:
                status = edge_step(g, w, q[k], dt, use_secondary, twist_space, is_infeasible)
        done[k] = status != REFUSED
        scales[k] = w.sensitivity[0]
        for dof in range(len(w.x)):
            velocities[k, dof] = w.x[dof]
