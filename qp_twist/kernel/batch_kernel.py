"""Independent single steps of many configurations, compiled."""

from __future__ import annotations

import numpy as np

from qp_twist.kernel.arm_kernel import pose_and_jacobian
from qp_twist.kernel.bounds import MOTION
from qp_twist.kernel.compiling import kernel
from qp_twist.kernel.edge_step import edge_step
from qp_twist.kernel.null_space import INDEPENDENT, least_norm, reflect
from qp_twist.kernel.step_kernel import RAISE, read_step, step
from qp_twist.kernel.twist_rows import desired_velocity, in_basis, left_free, twist_rows
from qp_twist.kernel.verified_program import AT_THE_EDGE, INFEASIBLE, REFUSED

MINIMUM_NORM, GRADIENT_PROJECTION, RMR, TWA = range(4)
"""Closed forms."""


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


@kernel
def closed_forms(arm, kinds, shape, held_kinds, held_shape, form, q, targets, h, moved, done):
    """Evaluate a closed form at each row of q (K, nq).

    Args:
        arm: The chain of the frame.
        kinds: Of the task's projector, (3,).
        shape: Of the task, (27,).
        held_kinds: Of the projector whose rows are inverted: the task's, or for RMR and TWA the
            operational one, (3,).
        held_shape: Of the same, (27,).
        form: Which closed form.
        q: Configurations, (K, nq).
        targets: R_d (9), p_d (3) and twist (6), (K, 18).
        h: Desired displacements, (K, nv); or (0, nv), none.
        moved: Result, (K, nv).
        done: Result, whether the task rows are linearly independent, (K,).
    """
    nv, m = moved.shape[1], held_kinds[0] + held_kinds[1]
    pose, J, A, b = np.zeros(12), np.zeros((6, nv)), np.zeros((m, nv)), np.zeros(m)
    V, R, free, ones = np.zeros((m, nv)), np.zeros((m, m)), np.zeros((0, nv)), np.ones(2)
    twist = np.zeros(6)
    for k in range(len(q)):
        done[k] = False
        pose_and_jacobian(arm, q[k], pose, J)
        twist_rows(held_kinds, held_shape, pose, targets[k], J, 1.0, A, b, free, ones)
        if m > nv or not reflect(A, V, R) >= INDEPENDENT:
            continue
        done[k] = True
        for dof in range(nv):
            moved[k, dof] = 0.0
            if form == GRADIENT_PROJECTION and len(h):
                moved[k, dof] = h[k, dof]
        if form == TWA:
            for block in range(2):
                x, y, z, u, v, w, _ = desired_velocity(block, kinds, shape, pose, targets[k], 1.0)
                twist[3 * block], twist[3 * block + 1], twist[3 * block + 2] = u, v, w
                if len(h):
                    left_free(kinds[block], x, y, z, J, h[k], 3 * block, twist)
            in_basis(held_kinds, held_shape, pose, targets[k], twist, b)
        least_norm(V, R, b, moved[k])
