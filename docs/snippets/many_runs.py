"""Three hundred runs with the workpiece elsewhere."""

import mink
import numpy as np

import qp_twist as qt

task = qt.load_task("deburring")
rng = np.random.default_rng(0)
moves = [mink.SE3.from_translation(rng.uniform(-0.1, 0.1, 3)) for _ in range(300)]

runs = qt.batch.follow(task, "qp_gradient", moves=moves, keep=False)

inside = runs.min_margin >= 0.0
print(f"{len(inside)} runs, {runs.steps.sum():,} verified steps")
print(f"left to the reference: {runs.by_reference.sum()}; failures: {runs.failures}")
print(f"inside all limits: {inside.sum()}, errors at most {runs.position_error.max():.0e} m")
print(f"largest step {np.degrees(runs.max_step.max()):.1f}°, mean z {runs.mean_z.mean():.4f}")
