"""One step without limits: the QP gives the closed form."""

import mink
import numpy as np

import qp_twist as qt

path = qt.load_task("deburring")
configuration = mink.Configuration(path.model, path.start)
task = qt.TwistTask("tool", "site", path.projector)
task.set_target(path.waypoints[0])
centering = qt.JointCentering(path.model, weight="paper", gain=0.1)

state = task.state(configuration)
arrays = state.jacobian, state.projector, state.error, centering.displacement(configuration)
closed = {
    "joint": qt.closed_form.gradient_projection(*arrays),
    "twist": qt.closed_form.twa(*arrays),
}
for space, formula in closed.items():
    controller = qt.Controller(
        path.model, [task], secondary=[centering], secondary_space=space, limits=[]
    )
    displacement = controller.step(configuration, dt=0.1).velocity * 0.1
    agree = np.abs(displacement - formula).max() < 1e-8
    print(f"{space}: the same to 1e-8 rad: {agree}")
