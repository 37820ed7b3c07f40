"""Where the twist decomposition and its QP move fastest on the deburring run."""

import mink
import numpy as np

import qp_twist as qt
from qp_twist.kinematics import frame_jacobian

path = qt.load_task("deburring")
configuration = mink.Configuration(path.model)
for method in ("twa", "qp"):
    q = qt.follow(path, method).q
    steps = np.degrees(np.abs(np.diff(q, axis=0))).max(axis=1)
    for i in range(1, len(steps) - 1):
        if steps[i] > 5.5 and steps[i - 1] < steps[i] >= steps[i + 1]:
            print(f"{method}: a step of {steps[i]:.1f}° at waypoint {i + 2}")
    smallest = []
    for row in q:
        configuration.update(row)
        J = frame_jacobian(configuration, "tool", "site")
        smallest.append(np.linalg.svd(J, compute_uv=False)[-1])
    print(
        f"{method}: J nearest to singular at waypoint {np.argmin(smallest) + 1} "
        f"(σ = {min(smallest):.4f})"
    )
    print(
        f"{method}: joint 5 passes zero at waypoint "
        f"{np.flatnonzero(np.diff(np.sign(q[:, 4])))[0] + 2}"
    )
