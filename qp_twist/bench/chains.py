"""Arms of any number of joints."""

from __future__ import annotations

import mujoco
import numpy as np

REACH = 1.5
"""Length of an arm, m, however many links it has."""
TIP = "tip"


def site_name(joint: int) -> str:
    """Name of the site at the far end of a link."""
    return f"after_{joint}"


def chain_model(joints: int, rng: np.random.Generator) -> mujoco.MjModel:
    """A serial arm with hinges about random axes across its links; its last site is ``tip``."""
    spec = mujoco.MjSpec()
    body = spec.worldbody
    length = REACH / joints
    for joint in range(joints):
        body = body.add_body(name=f"link_{joint}", pos=[0, 0, 0 if joint == 0 else length])
        angle = 0.5 * np.pi * (joint % 2) + rng.uniform(-0.5, 0.5)
        tilt = rng.uniform(-0.3, 0.3)
        axis = [np.cos(angle) * np.cos(tilt), np.sin(angle) * np.cos(tilt), np.sin(tilt)]
        body.add_joint(name=f"joint_{joint}", type=mujoco.mjtJoint.mjJNT_HINGE, axis=axis)
        body.add_geom(
            type=mujoco.mjtGeom.mjGEOM_CAPSULE, size=[0.02, 0, 0], fromto=[0, 0, 0, 0, 0, length]
        )
        body.add_site(name=site_name(joint), pos=[0, 0, length])
    body.add_site(name=TIP, pos=[0, 0, length])
    return spec.compile()
