"""Two tasks, one more important: the tip on its point, the last link upright where it can be."""

import sys

import mink
import numpy as np
from matplotlib.figure import Figure

import qp_twist as qt

path = qt.load_task("planar_line")
upright = qt.TwistProjector(
    linear=qt.Projector.none(), angular=qt.Projector.line([0, 0, 1]), frame="world"
)
tip = qt.TwistTask("tip", "site", path.projector)  # two rows
pointing = qt.TwistTask("tip", "site", upright)  # one row more: all three joints
# Joint ranges, and 2 rad/s at once: the targets begin at speed.
limits = [qt.MotionLimit(path.model, velocity=2.0, acceleration=None)]
controller = qt.Controller(path.model, levels=[[tip], [pointing]], limits=limits)

configuration = mink.Configuration(path.model, np.radians([45.0, 60.0, 100.0]))
home = configuration.get_transform_frame_to_world("tip", "site")
times, errors, dt = np.arange(0.0, 6.3, 0.02), [], 0.02
for t in times:
    shift = np.array([0.5 * np.sin(t), 0.5 * np.sin(2.0 * t), 0.0])
    for task in (tip, pointing):
        task.set_target(mink.SE3.from_translation(shift) @ home)
    step = controller.step(configuration, dt)
    configuration.integrate_inplace(step.velocity, dt)
    errors.append([np.linalg.norm(task.state(configuration).error) for task in (tip, pointing)])

figure = Figure(figsize=(8, 3.2), layout="constrained")
panel = figure.subplots()
for error, label, style in zip(
    np.array(errors).T,
    ("first level: tip, m", "second level: angle, rad"),
    ("-", "--"),
    strict=True,
):
    panel.semilogy(times, np.maximum(error, 1e-6), style, lw=2, label=label)
panel.set(xlabel="time, s", ylabel="error after the step", ylim=(1e-6, 3.0))
panel.legend(frameon=False)
panel.grid(alpha=0.3)
figure.savefig(sys.argv[1] if sys.argv[1:] else "gallery_07.png", dpi=110)
