"""Follow a path: the tip on a straight line, the free joint motion towards the mid-ranges."""

import sys

import mink
import numpy as np
from matplotlib.figure import Figure

import qp_twist as qt

task = qt.load_task("planar_line")
line = qt.follow(task, "qp_gradient")
print(line.summary)

configuration = mink.Configuration(task.model)
figure = Figure(figsize=(8, 3.4), layout="constrained")
left, right = figure.subplots(1, 2, width_ratios=[1.2, 1])
for k in range(0, len(line.q), 10):
    configuration.update(line.q[k])
    arm = np.vstack([configuration.data.xanchor, configuration.data.site("tip").xpos])
    left.plot(arm[:, 0], arm[:, 1], "-o", color="#0072B2", alpha=0.15 + 0.0085 * k, markersize=4)
left.plot(task.positions[:, 0], task.positions[:, 1], color="#D55E00", linewidth=2.5)
left.set(aspect="equal", xlabel="x, m", ylabel="y, m")

ranges = qt.JointRanges.of(task.model)
share = (line.q - ranges.lower) / (ranges.upper - ranges.lower)
waypoints = np.arange(1, len(line.q) + 1)
for name, curve, style in zip(ranges.names, share.T, ("-", "--", ":"), strict=True):
    right.plot(waypoints, 100 * curve, style, label=name, linewidth=2)
right.set(xlabel="waypoint", ylabel="joint, % of its range", ylim=(0, 100))
right.legend(frameon=False)
right.grid(alpha=0.3)
figure.savefig(sys.argv[1] if sys.argv[1:] else "gallery_02.png", dpi=110)
