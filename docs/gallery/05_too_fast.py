"""Ask for more speed than the joints have: scaled, the tip keeps its direction; relaxed, not."""

import itertools
import sys

import mink
import numpy as np
from matplotlib.figure import Figure
from scipy.spatial import ConvexHull

import qp_twist as qt
from qp_twist.kinematics import frame_jacobian

path = qt.load_task("planar_line")
configuration = mink.Configuration(path.model, path.start)
speeds = {"joint_1": 0.5, "joint_2": 0.5, "joint_3": 0.5}  # rad/s
J = frame_jacobian(configuration, "tip", "site")[:2]
asked, dt = np.array([3.0, 0.0]), 0.1  # m/s, along x

task = qt.TwistTask("tip", "site", path.projector)
tip = configuration.get_transform_frame_to_world("tip", "site")
task.set_target(mink.SE3.from_translation(np.array([*asked, 0.0]) * dt) @ tip)
moved = {}
for answer in ("scale", "relax"):
    limits = [mink.VelocityLimit(path.model, speeds)]
    controller = qt.Controller(path.model, [task], limits=limits, on_infeasible=answer)
    step = controller.step(configuration, dt)
    moved[answer] = J @ step.velocity
    print(step.message)

corners = np.array([J @ v for v in itertools.product([-0.5, 0.5], repeat=3)])
outline = corners[ConvexHull(corners).vertices]
figure = Figure(figsize=(8, 3.8), layout="constrained")
panel = figure.subplots()
panel.fill(*outline.T, color="#0072B2", alpha=0.12, label="the joints allow")
arrows = {"asked": asked, **moved}
for (name, v), colour, width in zip(
    arrows.items(), ("#999999", "#0072B2", "#D55E00"), (0.004, 0.010, 0.005), strict=True
):
    panel.quiver(
        0, 0, *v, color=colour, width=width, angles="xy", scale_units="xy", scale=1, label=name
    )
panel.set(aspect="equal", xlim=(-2.0, 3.2), ylim=(-1.75, 1.75))
panel.set(xlabel="speed of the tip along x, m/s", ylabel="along y, m/s")
panel.legend(frameon=False, loc="center left", bbox_to_anchor=(1.0, 0.5))
figure.savefig(sys.argv[1] if sys.argv[1:] else "gallery_05.png", dpi=110)
