"""Compose a controller by hand and take one step: the arm comes down on its first waypoint."""

import mink
import numpy as np

import qp_twist as qt

path = qt.load_task("deburring")  # here only for the robot, a pose to reach and a start near it

# What the task needs: the tool's position and axis. The roll about the tool's z is free.
roll_free = qt.TwistProjector(
    linear=qt.Projector.full(), angular=qt.Projector.plane([0, 0, 1]), frame="body"
)
task = qt.TwistTask("tool", "site", roll_free, gain=0.5)
task.set_target(path.waypoints[0])

# What limits the step: joint ranges from the scene, joint speeds from here.
names = qt.JointRanges.of(path.model).names
speeds = dict(zip(names, path.velocity_limits, strict=True))
limits = [qt.PositionLimit(path.model), mink.VelocityLimit(path.model, speeds)]

# What the free motion is spent on: staying near the middle of the joint ranges.
centering = qt.JointCentering(path.model, weight="natural", gain=0.05)
metric = qt.JointRanges.of(path.model).metric
controller = qt.Controller(path.model, [task], secondary=[centering], limits=limits, metric=metric)

configuration = mink.Configuration(path.model, path.start + 0.1)
step = controller.step(configuration, dt=0.01)
print(step.message)
print(f"scale {step.scale:.3f}")
print("velocity, deg/s:", np.degrees(step.velocity).round(1))
configuration.integrate_inplace(step.velocity, 0.01)
