"""Close the loop: a push against an arm with late servos, and three ways to listen to it."""

import sys

from matplotlib.figure import Figure
from simulated_robot import ClosedLoop, Push, Servos

import qp_twist as qt

path = qt.load_task("deburring")
task = qt.TwistTask("tool", "site", path.projector, gain=0.1)
task.set_target(path.waypoints[0])
controller = qt.Controller(path.model, [task])

push = Push("link_6", force=(0.0, 0.0, -300.0), start=0.2, duration=0.2)  # N, s
figure = Figure(figsize=(8, 3.2), layout="constrained")
panel = figure.subplots()
panel.axvspan(0.2, 0.4, color="#999999", alpha=0.2, label="300 N on the last link")
for kind, feedback, style in (
    ("position", "integrated", "-"),
    ("position", "measured", "--"),
    ("velocity", "measured", ":"),
):
    plant = Servos(path.model, kind=kind, lag=0.02)
    loop = ClosedLoop(controller, plant, path.start, period=0.01, feedback=feedback)
    record = loop.run(1.0, pushes=[push])
    panel.plot(
        record.time, 1e3 * record.position_error, style, lw=2, label=f"{kind} servos, {feedback}"
    )
panel.set(xlabel="time, s", ylabel="tool off its target, mm")
panel.legend(frameon=False)
panel.grid(alpha=0.3)
figure.savefig(sys.argv[1] if sys.argv[1:] else "gallery_12.png", dpi=110)
