"""A joint limit in the way: the closed form goes through, the quadratic program goes along it."""

import sys

import numpy as np
from matplotlib.figure import Figure

import qp_twist as qt

task = qt.load_task("planar_line")
task.model.jnt_range[0, 0] = np.radians(48.0)  # joint 1 may no longer go below 48°
closed = qt.follow(task, "minimum_norm")
program = qt.follow(task, "qp_minimum_norm")

waypoints = np.arange(1, len(closed.q) + 1)
figure = Figure(figsize=(8, 3.2), layout="constrained")
left, right = figure.subplots(1, 2)
left.axhspan(30.0, 48.0, color="#D00000", alpha=0.08)
left.axhline(48.0, color="#D00000", label="limit of joint 1")
for panel, joint in ((left, 0), (right, 2)):
    panel.plot(
        waypoints, np.degrees(closed.q[:, joint]), "--", color="#E69F00", lw=2, label="minimum_norm"
    )
    panel.plot(
        waypoints, np.degrees(program.q[:, joint]), color="#0072B2", lw=2, label="qp_minimum_norm"
    )
    panel.set(xlabel="waypoint", ylabel=f"joint {joint + 1}, degrees")
    panel.grid(alpha=0.3)
left.set(ylim=(30, 75))
left.legend(frameon=False)
figure.savefig(sys.argv[1] if sys.argv[1:] else "gallery_04.png", dpi=110)
