"""Independent single steps of many configurations, compiled."""

from __future__ import annotations

from qp_twist.kernel.arm_kernel import pose_and_jacobian
from qp_twist.kernel.bounds import MOTION
from qp_twist.kernel.compiling import kernel
from qp_twist.kernel.copying import put
from qp_twist.kernel.edge_step import edge_step
from qp_twist.kernel.step_kernel import step
from qp_twist.kernel.step_record import AT_THE_EDGE, INFEASIBLE, RAISE, REFUSED, read_step


@kernel
def steps(
    arms, floats, integers, q, before, targets, dt, use_secondary, twist_space, velocities, scales,
    done,
):  # fmt: skip
    """Compute a controller's step from each row of q (K, nq); for the arrays see ``step_record``.

    ``arms`` are the chains of the tasks' frames; ``floats`` and ``integers``, the arrays of one
    step, are overwritten; ``before`` are joint velocities that acceleration limits refer to,
    (K, nv), or (0, nv) for those in the tables of the limits; ``targets`` (K, T, 18) are R_d (9),
    p_d (3) and twist (6) of each task. Results are velocities (K, nv), the scale s of each step,
    and whether it is verified.
    """
    s = read_step(floats, integers)
    s.jacobians[:] = 0.0
    for k in range(len(q)):
        for task in range(len(s.kinds)):
            pose_and_jacobian(arms[task], q[k], s.poses[task], s.jacobians[task])
            put(targets[k, task], s.targets[task])
        for index in range(len(s.types) if len(before) > 0 else 0):
            if s.types[index] == MOTION:
                for dof in range(before.shape[1]):
                    s.limits[index, dof, 6] = before[k, dof]
        status = step(s, q[k], dt, use_secondary, twist_space)
        if status in (AT_THE_EDGE, INFEASIBLE):
            is_infeasible, status = status == INFEASIBLE, REFUSED
            if s.settings.infeasible != RAISE:
                status = edge_step(s, q[k], dt, use_secondary, twist_space, is_infeasible)
        done[k] = status != REFUSED
        scales[k] = s.sensitivity[0]
        for dof in range(len(s.x)):
            velocities[k, dof] = s.x[dof]
