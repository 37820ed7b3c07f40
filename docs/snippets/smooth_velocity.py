"""A term of one's own in the cost: the velocity shall not change much from step to step."""

import mink
import numpy as np

import qp_twist as qt


class SmoothVelocity(mink.Task):
    """½ w ‖q̇ − q̇_before‖²."""

    def __init__(self, model, weight, dt):
        super().__init__(cost=np.full(model.nv, np.sqrt(weight)))
        self.dt, self.before = dt, np.zeros(model.nv)

    def compute_error(self, configuration):  # rad or m, (nv,)
        return -self.dt * self.before

    def compute_jacobian(self, configuration):
        return np.eye(configuration.nv)


def largest_change(solver, weight, dt=0.05):
    """Of the joint velocities from step to step, rad/s, where the pull to the middle sets in."""
    path = qt.load_task("deburring")
    tool = qt.TwistTask("tool", "site", path.projector)
    smooth = SmoothVelocity(path.model, weight, dt)
    controller = qt.Controller(
        path.model, [tool, smooth] if weight else [tool],
        secondary=[qt.JointCentering(path.model, "natural", gain=0.05)], solver=solver,
    )  # fmt: skip
    configuration, changes = mink.Configuration(path.model, path.start), []
    for waypoint in path.waypoints[:60]:
        tool.set_target(waypoint)
        step = controller.step(configuration, dt)
        changes.append(np.abs(step.velocity - smooth.before).max())
        smooth.before = step.velocity
        configuration.integrate_inplace(step.velocity, dt)
    return max(changes[1:])


if __name__ == "__main__":
    for weight in (0.0, 10.0):
        for solver in ("compiled", "daqp"):
            print(f"w = {weight:4}, {solver:8}: {largest_change(solver, weight):.3f} rad/s")
