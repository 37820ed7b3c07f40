"""A step from where MuJoCo has put the joints and frames, compiled."""

from __future__ import annotations

from qp_twist.kernel.compiling import entry, part
from qp_twist.kernel.record import at_address
from qp_twist.kernel.step_kernel import hindered_step, read_step, step

GIVEN_JACOBIAN, ELSEWHERE = -2, -1
"""What stands in place of a joint: the task's Jacobian is given; the joint does not move it."""


@part
def _jacobian(links, axes, anchors, origin, J):
    """World-aligned Jacobian of a frame at ``origin``, joint by joint: a and a × (p − p₀), or a, 0.

    ``links`` says of each degree of freedom 2 · joint, and 1 more where it slides; axes and anchors
    are MuJoCo's, (njnt · 3,).
    """
    for dof in range(len(links)):
        for row in range(6):
            J[row, dof] = 0.0
        if links[dof] == ELSEWHERE:
            continue
        at = 3 * (links[dof] // 2)
        x, y, z = axes[at], axes[at + 1], axes[at + 2]
        if links[dof] % 2:
            J[0, dof], J[1, dof], J[2, dof] = x, y, z
            continue
        u, v, w = origin[0] - anchors[at], origin[1] - anchors[at + 1], origin[2] - anchors[at + 2]
        J[0, dof], J[1, dof], J[2, dof] = y * w - z * v, z * u - x * w, x * v - y * u
        J[3, dof], J[4, dof], J[5, dof] = x, y, z


@part
def _target(pose, target):
    """Rotation and position of a target from its unit quaternion and position."""
    w, x, y, z = pose[0], pose[1], pose[2], pose[3]
    target[0], target[4] = w * w + x * x - y * y - z * z, w * w - x * x + y * y - z * z
    target[8] = w * w - x * x - y * y + z * z
    target[1], target[3] = 2.0 * (x * y - w * z), 2.0 * (x * y + w * z)
    target[2], target[6] = 2.0 * (x * z + w * y), 2.0 * (x * z - w * y)
    target[5], target[7] = 2.0 * (y * z - w * x), 2.0 * (y * z + w * x)
    for i in range(3):
        target[9 + i] = pose[4 + i]


@entry
def live_step(floats, integers, dt, use_secondary, twist_space):
    """A step; ``controller.compiled_step`` lays out the arrays, as ``step_record`` says.

    Targets are taken from where they stand as quaternions, poses and Jacobians from MuJoCo, whose
    addresses are the ``sources``: of q (nq), axes and anchors of the joints, and of each task's
    frame the rotation (9) and the position (3); then come nq, and how many joints there are.

    Returns:
        As ``step_kernel.step``.
    """
    s = read_step(floats, integers, integers)
    g, w = s.given, s.program
    sources, links = g.sources, g.links
    tasks = len(links)
    nq, joints = sources[3 + 2 * tasks], sources[4 + 2 * tasks]
    axes, anchors = at_address(sources[1], 3 * joints), at_address(sources[2], 3 * joints)
    for task in range(tasks):
        rotation = at_address(sources[3 + 2 * task], 9)
        position = at_address(sources[4 + 2 * task], 3)
        for i in range(9):
            g.poses[task, i] = rotation[i]
        for i in range(3):
            g.poses[task, 9 + i] = position[i]
        _target(g.target_poses[task], g.targets[task])
        if links[task, 0] != GIVEN_JACOBIAN:
            _jacobian(links[task], axes, anchors, position, g.jacobians[task])
    return step(g, w, at_address(sources[0], nq), dt, use_secondary, twist_space)


@entry
def live_hindered_step(floats, integers):
    """What :func:`live_step` has found too fast, as ``step_kernel.hindered_step``."""
    s = read_step(floats, integers, integers)
    return hindered_step(s.given, s.program)
