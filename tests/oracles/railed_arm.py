"""The deburring arm on a rail along x."""

import mujoco

import qp_twist as qt


def railed_arm(task: qt.PathTask) -> mujoco.MjModel:
    """Its scene with a slide of ±0.5 m, ``rail``, below the arm's base."""
    spec = mujoco.MjSpec.from_file(str(task.scene))
    spec.body("base").add_joint(
        name="rail", type=mujoco.mjtJoint.mjJNT_SLIDE, axis=[1.0, 0.0, 0.0], range=[-0.5, 0.5],
        limited=1,
    )  # fmt: skip
    return spec.compile()
