"""Methods side by side: three closed forms and the quadratic programs that hold their limits."""

import sys

import numpy as np
from matplotlib.figure import Figure

import qp_twist as qt

names = ["minimum_norm", "gradient_projection", "qp_gradient", "twa", "qp"]
comparison = qt.compare("planar_line", methods=names)
print(comparison.table())

colours = {"minimum_norm": "#009E73", "gradient_projection": "#CC79A7", "qp_gradient": "#CC79A7"}
figure = Figure(figsize=(8, 3.2), layout="constrained")
left, right = figure.subplots(1, 2)
for name, line in comparison.trajectories.items():
    style = {"color": colours.get(name, "#0072B2"), "ls": "-" if name.startswith("qp") else "--"}
    waypoints = np.arange(1, len(line.q) + 1)
    left.semilogy(waypoints, line.z, lw=2, label=name, **style)
    right.plot(waypoints, line.margins.min(axis=1), lw=2, **style)
left.set(xlabel="waypoint", ylabel="z: how far from mid-range")
right.axhline(0.0, color="#D00000")
right.set(xlabel="waypoint", ylabel="smallest margin; below 0: outside", ylim=(-0.6, 0.6))
for panel in (left, right):
    panel.grid(alpha=0.3)
figure.legend(loc="outside lower center", ncols=5, frameon=False, fontsize=9)
figure.savefig(sys.argv[1] if sys.argv[1:] else "gallery_08.png", dpi=110)
