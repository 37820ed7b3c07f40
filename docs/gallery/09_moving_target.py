"""A target that moves: told its twist, the tip does not lag behind."""

import sys

import mink
import numpy as np
from matplotlib.figure import Figure

import qp_twist as qt

path = qt.load_task("planar_line")
dt = 0.02
times = np.arange(0.0, 4.0, dt)


def belt(t: float) -> mink.SE3:
    """A part on a belt that speeds up and slows down."""
    return mink.SE3.from_translation(np.array([-1.0 + 0.5 * t - 0.2 * np.sin(2.0 * t), 2.0, 0.0]))


errors = {}
for told in (False, True):
    task = qt.TwistTask("tip", "site", path.projector, gain=0.1)
    controller = qt.Controller(path.model, [task])
    configuration = mink.Configuration(path.model, path.start)
    errors[told] = []
    for t in times:
        twist = qt.target_twist(belt(t), belt(t + dt), dt) if told else None
        task.set_target(belt(t), twist)
        step = controller.step(configuration, dt)
        configuration.integrate_inplace(step.velocity, dt)
        task.set_target(belt(t + dt))
        errors[told].append(1e3 * np.linalg.norm(task.state(configuration).error[:3]))

figure = Figure(figsize=(8, 3.2), layout="constrained")
panel = figure.subplots()
panel.semilogy(times, errors[False], "--", color="#E69F00", lw=2, label="pose only")
panel.semilogy(times, errors[True], color="#0072B2", lw=2, label="pose and twist")
panel.set(xlabel="time, s", ylabel="tip off the part, mm")
panel.legend(frameon=False)
panel.grid(alpha=0.3)
figure.savefig(sys.argv[1] if sys.argv[1:] else "gallery_09.png", dpi=110)
