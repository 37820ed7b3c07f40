"""A push against the deburring robot at rest: who notices it, and who holds against it."""

from simulated_robot import ClosedLoop, Push, Servos

import qp_twist as qt

path = qt.load_task("deburring")
task = qt.TwistTask("tool", "site", path.projector, gain=0.1)
task.set_target(path.waypoints[0])
controller = qt.Controller(path.model, [task])

push = Push("link_6", force=(0.0, 0.0, -300.0), start=0.5, duration=0.2)  # N, s
for kind, feedback in (
    ("position", "integrated"),
    ("position", "measured"),
    ("velocity", "integrated"),
    ("velocity", "measured"),
):
    plant = Servos(path.model, kind=kind, lag=0.02)
    loop = ClosedLoop(controller, plant, path.start, period=0.01, feedback=feedback)
    record = loop.run(1.2, pushes=[push])
    error = 1e3 * record.position_error
    print(f"{kind} servos, {feedback:10}: {error.max():5.1f} mm, at the end {error[-1]:5.1f} mm")
