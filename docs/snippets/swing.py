"""After one full step of the swing, how far is the tool axis from where it should be?"""

import mink
import numpy as np

from qp_twist.geometry import geodesic


def rotation(*rotation_vector):
    return mink.SO3.exp(np.array(rotation_vector)).as_matrix()


def angle(a, b):
    return np.degrees(np.arctan2(np.linalg.norm(np.cross(a, b)), a @ b))


R = rotation(0.3, -0.5, 0.2)  # the frame
R_d = rotation(0.7, 0.1, 0.0) @ R @ rotation(0.0, 0.0, 1.2)  # its target: a swing and a roll
R_e = R_d @ R.T

for axis, e in (("body", R[:, 2]), ("world", np.array([0.0, 0.0, 1.0]))):
    for name, step in (
        ("e → R_e e ", geodesic(e, R_e @ e)),
        ("R_eᵀe → e", geodesic(R_e.T @ e, e)),
    ):
        left = R_d @ (rotation(*step) @ R).T  # R_e after the step
        e_after = rotation(*step) @ e if axis == "body" else e
        print(
            f"axis fixed to the {axis:5}: step {name} leaves {angle(e_after, left @ e_after):5.2f}°"
        )
