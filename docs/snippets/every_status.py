"""One situation for each outcome of a step."""

import mink
import numpy as np

import qp_twist as qt
from qp_twist.kinematics import frame_jacobian

path = qt.load_task("planar_line")
configuration = mink.Configuration(path.model, path.start)
tip = configuration.get_transform_frame_to_world("tip", "site")
speeds = {"joint_1": 0.5, "joint_2": 0.5, "joint_3": 0.5}
limits = [qt.PositionLimit(path.model), mink.VelocityLimit(path.model, speeds)]
task = qt.TwistTask("tip", "site", path.projector)


def step(shift, on_infeasible="scale"):
    task.set_target(mink.SE3.from_translation(np.array([shift, 0.0, 0.0])) @ tip)
    controller = qt.Controller(path.model, [task], limits=limits, on_infeasible=on_infeasible)
    return controller.step(configuration, dt=0.1)


J = frame_jacobian(configuration, "tip", "site")
for shift, choice in ((0.01, "scale"), (0.3, "scale"), (0.3, "relax")):
    result = step(shift, choice)
    vx, vy = (J @ result.velocity)[:2].round(3) + 0.0
    print(
        f"{result.message}\n    asked: {shift / 0.1:g} m/s along x; the tip moves at ({vx}, {vy})"
    )
try:
    step(0.3, "raise")
except qt.InfeasibleStep as error:
    print(f"InfeasibleStep: {error}")
    error.problem.save("step.npz")  # the arrays of the program, to look at or to send
