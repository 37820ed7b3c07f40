"""One situation for each outcome of a step."""

import mink
import numpy as np

import qp_twist as qt
from qp_twist.kinematics import frame_jacobian

path = qt.load_task("planar_line")
configuration = mink.Configuration(path.model, path.start)
stretched = mink.Configuration(path.model, np.array([0.7, 1e-4, 0.0]))
speeds = {"joint_1": 0.5, "joint_2": 0.5, "joint_3": 0.5}
limits = [qt.PositionLimit(path.model), mink.VelocityLimit(path.model, speeds)]
upright = qt.TwistProjector(
    linear=qt.Projector.none(), angular=qt.Projector.line([0, 0, 1]), frame="world"
)
tip = qt.TwistTask("tip", "site", path.projector)
pointing = qt.TwistTask("tip", "site", upright)


def step(shift, on_infeasible="scale", levels=((tip,),), where=configuration):
    here = where.get_transform_frame_to_world("tip", "site")
    for task in (tip, pointing):
        task.set_target(mink.SE3.from_translation(np.array([shift, 0.0, 0.0])) @ here)
    controller = qt.Controller(
        path.model, levels=levels, limits=limits, on_infeasible=on_infeasible
    )
    return controller.step(where, dt=0.1)


def show(shift, result, where=configuration):
    vx, vy = (frame_jacobian(where, "tip", "site") @ result.velocity)[:2].round(3) + 0.0
    print(
        f"{result.message}\n    asked: {shift / 0.1:g} m/s along x; the tip moves at ({vx}, {vy})"
    )


show(0.01, step(0.01))
show(0.13, step(0.13, levels=[[tip], [pointing]]))
show(-0.1, step(-0.1, where=stretched), stretched)
show(0.3, step(0.3))
show(0.3, step(0.3, "relax"))
try:
    step(0.3, "raise")
except qt.InfeasibleStep as error:
    print(f"InfeasibleStep: {error}")
    error.problem.save("step.npz")  # the arrays of the program, to look at or to send
