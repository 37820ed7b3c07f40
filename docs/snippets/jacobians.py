"""What the full Jacobian cannot do."""

import mink
import numpy as np

import qp_twist as qt
from qp_twist.kinematics import frame_jacobian

planar = qt.load_task("planar_line")
configuration = mink.Configuration(planar.model, planar.start)
J = frame_jacobian(configuration, "tip", "site")
print(
    f"planar 3R: J is {J.shape[0]} × {J.shape[1]}, J Jᵀ has rank {np.linalg.matrix_rank(J @ J.T)}"
)
J_o = planar.operational.basis.T @ J
print(
    f"           the operational rows are {J_o.shape[0]} × {J_o.shape[1]}, "
    f"rank {np.linalg.matrix_rank(J_o)}"
)

path = qt.load_task("deburring")
task = qt.TwistTask("tool", "site", path.projector)
configuration = mink.Configuration(path.model, np.radians([20, 30, -40, 50, 0, 60]))
task.set_target_from_configuration(configuration)
state = task.state(configuration)
rows = state.basis.T @ state.jacobian
print(
    f"straight wrist: J has rank {np.linalg.matrix_rank(state.jacobian)} of 6, "
    f"the task rows rank {np.linalg.matrix_rank(rows)} of 5"
)

configuration.update(path.start)
task.set_target(
    configuration.get_transform_frame_to_world("tool", "site").plus(
        np.array([0.01, 0.0, 0.0, 0.0, 0.0, 0.0])
    )
)
state = task.state(configuration)
J, T, error = state.jacobian, state.projector, state.error
for name, step in (
    ("J†TΔt", qt.closed_form.twa(J, T, error, np.zeros(6))),
    ("(TJ)†TΔt", qt.closed_form.minimum_norm(J, T, error)),
):
    roll = state.projector.angular.axis @ (J @ step)[3:]
    print(
        f"{name:8}: roll {np.degrees(roll):6.3f}°, length {np.degrees(np.linalg.norm(step)):.3f}°"
    )
