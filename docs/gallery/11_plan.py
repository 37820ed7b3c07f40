"""Look at the whole path: step by step the arm meets a limit, a plan stays away from all."""

import sys

import numpy as np
from matplotlib.figure import Figure

import qp_twist as qt

task = qt.load_task("planar_line")
task.model.jnt_range[2, 1] = np.radians(110.0)  # joint 3 may no longer go above 110°
local = qt.follow(task, "qp_minimum_norm")
plan = qt.plan(task, "margin")
print(
    f"plan: {plan.value:.2f}° from the nearest limit; no motion does better than {plan.bound:.2f}°"
)

ranges = qt.JointRanges.of(task.model)
figure = Figure(figsize=(8, 3.2), layout="constrained")
panel = figure.subplots()
for q, label, colour, style in (
    (local.q, "qp_minimum_norm, waypoint by waypoint", "#0072B2", "--"),
    (plan.q, "plan of the whole path", "#000000", "-"),
):
    nearest = np.degrees(np.minimum(q - ranges.lower, ranges.upper - q)).min(axis=1)
    panel.plot(np.arange(1, len(q) + 1), nearest, style, color=colour, lw=2, label=label)
panel.axhline(plan.bound, color="#009E73", ls=":", label="bound of the plan")
panel.set(xlabel="waypoint", ylabel="nearest joint limit, degrees", ylim=(0, None))
panel.legend(frameon=False)
panel.grid(alpha=0.3)
figure.savefig(sys.argv[1] if sys.argv[1:] else "gallery_11.png", dpi=110)
