"""A constraint of one's own: a plan keeps it, a check finds where another motion does not."""

import dataclasses

import numpy as np

import qp_twist as qt
from qp_twist.kinematics import SerialChain


class HalfSpace(qt.Constraint):
    """The origin of a frame stays where n·p ≥ d."""

    kind = "half-space"

    def __init__(self, model, frame_name, frame_type, normal, offset):
        self.chain = SerialChain.of(model, frame_name, frame_type)
        self.normal, self.offset = np.asarray(normal, dtype=float), offset
        self.names, self.units = (frame_name,), ("m",)

    def margins(self, q):  # (N, 1)
        _, origins = self.chain.poses(q)
        return (origins @ self.normal - self.offset)[:, None]

    def gradients(self, q):  # (N, 1, nv)
        _, _, jacobians = self.chain.poses_and_jacobians(q)
        return (self.normal @ jacobians[:, :3])[:, None]

    def change(self, q, travel):  # (N, 1): no further than the frame can come
        return self.chain.path_length(q, travel)[:, None]


if __name__ == "__main__":
    task = qt.load_task("deburring")
    wrist = HalfSpace(task.model, "link_5", "body", [0, 0, 1], 0.8)
    kept = dataclasses.replace(task, constraints=(wrist,))

    for name, path_task in (("without it", task), ("with it", kept)):
        plan = qt.plan(path_task)
        print(f"{name}, mean z {plan.value:.4f}:")
        run = qt.follow(path_task, "qp_planned", plan=plan)
        for finding in qt.check_trajectory(run, kept).findings:
            if "half-space" in finding.name:
                print(" ", finding)
    try:
        qt.follow(kept, "sns")
    except qt.InvalidInput as refused:
        print(refused)
