"""Free what the task does not need: the same run with the tool's roll prescribed, and free."""

import sys

import numpy as np
from matplotlib.figure import Figure

import qp_twist as qt

task = qt.load_task("deburring")  # position and axis of the tool: five rows for six joints
prescribed = qt.follow(task, "rmr")  # a rule says the roll, which makes it six
free = qt.follow(task, "minimum_norm")  # the shortest step in the five rows

ranges = qt.JointRanges.of(task.model)
waypoints = np.arange(1, len(free.q) + 1)
figure = Figure(figsize=(8, 3.2), layout="constrained")
for panel, joint in zip(figure.subplots(1, 2), (3, 5), strict=True):
    for run, label, colour, style in (
        (prescribed, "roll by a rule", "#E69F00", "--"),
        (free, "roll free", "#0072B2", "-"),
    ):
        panel.plot(waypoints, np.degrees(run.q[:, joint]), style, color=colour, label=label, lw=2)
    for limit in np.degrees([ranges.lower[joint], ranges.upper[joint]]):
        panel.axhline(limit, color="#D00000")
    panel.set(title=ranges.names[joint], xlabel="waypoint", ylabel="degrees")
    panel.grid(alpha=0.3)
panel.legend(frameon=False)
figure.savefig(sys.argv[1] if sys.argv[1:] else "gallery_03.png", dpi=110)
