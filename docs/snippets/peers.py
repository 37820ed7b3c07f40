"""mink's own step on the deburring run, set up well and as first written."""

import numpy as np

import qp_twist as qt

task = qt.load_task("deburring")
runs = (
    ("qp_gradient", {}),
    ("mink", {}),
    ("mink", {"iterations": 1}),
    ("mink_default", {}),
    ("mink_default", {"iterations": 20}),
)
for method, options in runs:
    run = qt.follow(task, method, **options)
    error = 1e3 * run.position_error.max()
    shown = "less than 1e-5" if error < 1e-5 else f"{error:.2f}"
    step = np.degrees(np.abs(np.diff(run.q, axis=0)).max())
    said = sorted({status.name for status in run.statuses})
    name = f"{method}, {run.path_task.settings(method).model_copy(update=options).iterations} it."
    print(
        f"{name:<21} z {run.z.mean():.4f}, off by {shown} mm, largest step {step:.1f}°, says {said}"
    )
