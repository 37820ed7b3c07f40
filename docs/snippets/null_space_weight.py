"""Seven joints, twist-space secondary: how far from J†TΔt + (1 − J†TJ)h is the QP's step?"""

import mink
import mujoco
import numpy as np

import qp_twist as qt
from qp_twist.qp import QuadraticProgram, solve

DT = 0.1
LINK = '<body pos="0 0 0.2"><joint axis="{}" range="-2.9 2.9"/><geom size="0.03"/>'
AXES = ["0 0 1", "0 1 0", "0 0 1", "0 1 0", "0 0 1", "0 1 0", "0 0 1"]
model = mujoco.MjModel.from_xml_string(
    f"<mujoco><worldbody>{''.join(LINK.format(a) for a in AXES)}"
    f'<site name="tool" pos="0.1 0 0.1"/>{"</body>" * 7}</worldbody></mujoco>'
)
roll_free = qt.TwistProjector(
    linear=qt.Projector.full(), angular=qt.Projector.plane([0, 0, 1]), frame="body"
)
task = qt.TwistTask("tool", "site", roll_free)
configuration = mink.Configuration(model)
rng = np.random.default_rng(0)
weights = [1e-4, 1e-6, 1e-8, 1e-10, 1e-12]
worst = dict.fromkeys([*weights, "null space"], 0.0)
for _ in range(20):
    configuration.update(rng.uniform(-1.5, 1.5, 7))
    pose = configuration.get_transform_frame_to_world("tool", "site")
    task.set_target(pose.plus(0.1 * rng.normal(size=6)))
    posture = qt.PostureReference(model, rng.uniform(-1.5, 1.5, 7), gain=0.3)
    h = posture.displacement(configuration)
    s = task.state(configuration)
    formula = qt.closed_form.twa(s.jacobian, s.projector, s.error, h, manipulator_redundancy=True)

    controller = qt.Controller(
        model, [task], secondary=[posture], secondary_space="twist", limits=[]
    )
    step = controller.step(configuration, DT).velocity * DT
    worst["null space"] = max(worst["null space"], np.abs(step - formula).max())

    A, b = task.velocity_rows(configuration, DT)
    V = s.projector.complement.basis
    nothing, infinity = np.zeros((0, 7)), np.full(7, np.inf)
    for rho in weights:  # the plain weight: ½‖(1−T)J(q̇ − ḣ)‖² + ½ρ‖q̇ − ḣ‖²
        cost = s.jacobian.T @ V @ V.T @ s.jacobian + rho * np.eye(7)
        problem = QuadraticProgram(
            cost, -cost @ h / DT, A, b, nothing, np.zeros(0), -infinity, infinity
        )
        result = solve(problem, "daqp")
        error = np.abs(result.x * DT - formula).max() if hasattr(result, "x") else np.inf
        worst[rho] = max(worst[rho], error)
for weight, error in worst.items():
    said = f"largest deviation {error:.0e} rad" if error < np.inf else "no verified solution"
    name = weight if weight == "null space" else f"ρ = {weight:g}"
    print(f"{name:10}: {said}")
