"""A secondary objective of one's own: cables on the forearm are twisted as little as possible."""

import mink
import numpy as np

import qp_twist as qt


class StraightCables(qt.SecondaryObjective):
    """Draws joint 4, which turns the forearm, towards 0."""

    def direction(self, configuration: mink.Configuration) -> np.ndarray:
        h = np.zeros(self.model.nv)
        h[3] = -configuration.q[3]
        return h


if __name__ == "__main__":
    task = qt.load_task("deburring")
    for secondary in ("none", "centering", StraightCables(task.model, gain=0.05)):
        run = qt.follow(task, "qp_gradient", secondary=secondary)
        twist = np.degrees(np.sqrt(np.mean(run.q[:, 3] ** 2)))
        print(f"{run.path_task.settings('qp_gradient')}: joint 4 at {twist:.1f}° (r.m.s.)")
        assert run.position_error.max() < 1e-8  # the task is kept in any case
