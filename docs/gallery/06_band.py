"""A range instead of freedom: a cable on the tool lets it roll by 45° either way, and no more."""

import dataclasses
import sys

import mink
import numpy as np
from matplotlib.figure import Figure

import qp_twist as qt
from qp_twist.geometry import twist_angle

task = qt.load_task("deburring_bands")  # a RollBand of ±45° about the tool's z
with_band = qt.follow(task, "qp_gradient")
without = qt.follow(dataclasses.replace(task, bands=()), "qp_gradient")

configuration = mink.Configuration(task.model)


def rolls(run: qt.Trajectory) -> list[float]:
    """The roll at every waypoint, measured from the roll that the path states, degrees."""
    found = []
    for q, waypoint in zip(run.q, task.waypoints, strict=True):
        configuration.update(q)
        tool = configuration.get_transform_frame_to_world("tool", "site").rotation().as_matrix()
        turned = tool @ waypoint.rotation().as_matrix().T
        found.append(np.degrees(twist_angle(turned, tool[:, 2])))
    return found


waypoints = np.arange(1, len(task.waypoints) + 1)
figure = Figure(figsize=(8, 3.2), layout="constrained")
panel = figure.subplots()
panel.axhspan(-45.0, 45.0, color="#009E73", alpha=0.12, label="the band")
panel.plot(waypoints, rolls(without), "--", color="#E69F00", lw=2, label="roll free")
panel.plot(waypoints, rolls(with_band), color="#0072B2", lw=2, label="roll within the band")
panel.set(xlabel="waypoint", ylabel="roll of the tool, degrees")
panel.legend(frameon=False)
panel.grid(alpha=0.3)
figure.savefig(sys.argv[1] if sys.argv[1:] else "gallery_06.png", dpi=110)
