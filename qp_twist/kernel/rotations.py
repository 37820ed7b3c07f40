"""Rotation matrices, in scalars."""

from __future__ import annotations

import math

from qp_twist.kernel.compiling import part


@part
def rotation_of(quaternion, R):
    """Write the rotation (9,) of a quaternion (4,), which need not have unit length."""
    a, x, y, z = quaternion[0], quaternion[1], quaternion[2], quaternion[3]
    size = a * a + x * x + y * y + z * z
    twice = 2.0 / size if size > 0.0 else 0.0
    R[0], R[4] = 1.0 - twice * (y * y + z * z), 1.0 - twice * (x * x + z * z)
    R[8] = 1.0 - twice * (x * x + y * y)
    R[1], R[3] = twice * (x * y - a * z), twice * (x * y + a * z)
    R[2], R[6] = twice * (x * z + a * y), twice * (x * z - a * y)
    R[5], R[7] = twice * (y * z - a * x), twice * (y * z + a * x)


@part
def turn_about(axis, angle, R):
    """R ← exp([axis] angle) R (Rodrigues)."""
    sine, less = math.sin(angle), 2.0 * math.sin(0.5 * angle) ** 2
    x, y, z = axis[0], axis[1], axis[2]
    for j in range(3):
        a, b, c = R[j], R[3 + j], R[6 + j]
        along = less * (x * a + y * b + z * c)
        R[j] += sine * (y * c - z * b) + x * along - less * a
        R[3 + j] += sine * (z * a - x * c) + y * along - less * b
        R[6 + j] += sine * (x * b - y * a) + z * along - less * c
