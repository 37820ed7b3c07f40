"""How often does the secondary step, alone, raise z to first order?"""

import mink
import numpy as np

import qp_twist as qt

COUNT = 2000
path = qt.load_task("deburring")
ranges = qt.JointRanges.of(path.model)
task = qt.TwistTask("tool", "site", path.projector)
gradient = qt.JointCentering(path.model, weight="gradient")
paper = qt.JointCentering(path.model, weight="paper")
configuration = mink.Configuration(path.model)
rng = np.random.default_rng(0)
raised = {}
for _ in range(COUNT):
    configuration.update(rng.uniform(ranges.lower, ranges.upper))
    task.set_target_from_configuration(configuration)
    state = task.state(configuration)
    J, T, error = state.jacobian, state.projector, state.error  # the error is zero
    downhill = gradient.direction(configuration)  # −∇z
    for h, desired in (("−∇z", gradient), ("the paper's", paper)):
        for form in (qt.closed_form.twa, qt.closed_form.gradient_projection):
            step = form(J, T, error, desired.direction(configuration))
            slope = -(downhill @ step) / np.linalg.norm(downhill) / np.linalg.norm(step)
            key = f"{form.__name__}, h: {h}"
            raised[key] = raised.get(key, 0) + (slope > 1e-9)
for key, number in raised.items():
    print(f"{key:35} raises z in {100 * number / COUNT:4.1f} % of {COUNT} configurations")
