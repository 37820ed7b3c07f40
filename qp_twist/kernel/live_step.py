"""A step from the poses and joint axes in MuJoCo's data, compiled."""

from __future__ import annotations

from qp_twist.kernel.compiling import kernel, part, plain
from qp_twist.kernel.copying import put
from qp_twist.kernel.edge_step import edge_step
from qp_twist.kernel.record import at_address
from qp_twist.kernel.rotations import rotation_of
from qp_twist.kernel.step_kernel import step
from qp_twist.kernel.step_record import read_step

PYTHON_JACOBIAN, NO_EFFECT = -2, -1
"""Entries of ``links`` that are no joint: Python computes the task's Jacobian; the joint does not
move the frame."""


@part
def _jacobian(links, axes, anchors, origin, J):
    """World-aligned Jacobian of a frame at ``origin``, joint by joint: a and a × (p − p₀), or a, 0.

    ``links`` has 2 · joint for a hinge and 2 · joint + 1 for a slide joint, for each degree of
    freedom; axes and anchors are MuJoCo's, (njnt · 3,).
    """
    for dof in range(len(links)):
        for row in range(6):
            J[row, dof] = 0.0
        if links[dof] == NO_EFFECT:
            continue
        at = 3 * (links[dof] // 2)
        x, y, z = axes[at], axes[at + 1], axes[at + 2]
        if links[dof] % 2:
            J[0, dof], J[1, dof], J[2, dof] = x, y, z
            continue
        u, v, w = origin[0] - anchors[at], origin[1] - anchors[at + 1], origin[2] - anchors[at + 2]
        J[0, dof], J[1, dof], J[2, dof] = y * w - z * v, z * u - x * w, x * v - y * u
        J[3, dof], J[4, dof], J[5, dof] = x, y, z


@plain
def take_poses(s):
    """Write R and p of frames and targets, and Jacobians.

    Target rotations are computed from ``target_poses``; poses and Jacobians are read from MuJoCo.
    ``sources`` contains the addresses of q (nq), joint axes and joint anchors; for each task those
    of its frame's rotation (9) and position (3); then nq and the number of joints.
    """
    sources, links = s.sources, s.links
    tasks = len(links)
    joints = sources[4 + 2 * tasks]
    axes, anchors = at_address(sources[1], 3 * joints), at_address(sources[2], 3 * joints)
    for task in range(tasks):
        position = at_address(sources[4 + 2 * task], 3)
        put(at_address(sources[3 + 2 * task], 9), s.poses[task])
        rotation_of(s.target_poses[task], s.targets[task])
        for i in range(3):
            s.poses[task, 9 + i] = position[i]
            s.targets[task, 9 + i] = s.target_poses[task, 4 + i]
        if links[task, 0] != PYTHON_JACOBIAN:
            _jacobian(links[task], axes, anchors, position, s.jacobians[task])


@kernel
def live_step(floats, integers, dt, use_secondary, twist_space):
    """``step_kernel.step`` from the addresses of the arrays of ``control.step_arrays``.

    As arrays they would take 0.3 µs.
    """
    s = read_step(floats, integers)
    take_poses(s)
    qpos = at_address(s.sources[0], s.sources[3 + 2 * len(s.links)])
    return step(s, qpos, dt, use_secondary, twist_space)


@kernel
def live_edge_step(floats, integers, dt, use_secondary, twist_space, is_infeasible):
    """Compute what :func:`live_step` found infeasible or at the edge: ``edge_step.edge_step``."""
    s = read_step(floats, integers)
    qpos = at_address(s.sources[0], s.sources[3 + 2 * len(s.links)])
    return edge_step(s, qpos, dt, use_secondary, twist_space, is_infeasible)
