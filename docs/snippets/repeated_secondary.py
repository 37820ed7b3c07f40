"""The closed form with the secondary in every inner iteration instead of only the first."""

import mink
import numpy as np

import qp_twist as qt

path = qt.load_task("deburring")
start = qt.follow(path, "twa").q[0]
task = qt.TwistTask("tool", "site", path.projector)
centering = qt.JointCentering(path.model, weight="paper", gain=1.0)
for iterations in (1, 2, 3):
    configuration = mink.Configuration(path.model, start)
    largest = 0.0
    for waypoint in path.waypoints[1:]:
        task.set_target(waypoint)
        for _ in range(iterations):
            s = task.state(configuration)
            h = centering.displacement(configuration)
            step = qt.closed_form.twa(s.jacobian, s.projector, task.clamped(s.error), h)
            configuration.integrate_inplace(step, 1.0)
        largest = max(largest, np.linalg.norm(task.state(configuration).error[:3]))
        if np.abs(configuration.q).max() > 1e3:
            break
    end = "diverges" if np.abs(configuration.q).max() > 1e3 else f"off by {1e3 * largest:.1f} mm"
    print(f"{iterations} iteration(s) a waypoint, secondary in each: {end}")
