"""A six-axis arm and a table that turns and tilts, modelled twice."""

import math

import mujoco
import numpy as np

import qp_twist as qt

CENTRE = np.array([0.0, 1.0, 0.3])
"""Where the axes of the table meet, m."""
TURN, TILT = math.pi, math.radians(60.0)


def arm_that_moves(leans: float = 0.0) -> mujoco.MjModel:
    """The plate is the world, and the arm's base moves against it.

    First about the plate's axis, then about the one that tilts, both with reversed axes. Two balls
    above the table, one of the plate and one of the floor, touch unless it ``leans`` so far, rad.
    """
    spec = mujoco.MjSpec.from_file(str(qt.load_task("deburring").scene))
    for name, axis, most in (("turn", [0.0, 0.0, -1.0], TURN), ("tilt", [-1.0, 0.0, 0.0], TILT)):
        spec.body("base").add_joint(
            name=name, axis=axis, pos=CENTRE, range=[-most, most], limited=1
        )  # fmt: skip
    for body in (spec.worldbody, spec.body("base")) if leans else ():
        body.add_geom(
            name=f"ball_of_{body.name}", type=mujoco.mjtGeom.mjGEOM_SPHERE,
            pos=CENTRE + np.array([0.0, 0.0, 1.0]), size=[math.sin(0.5 * leans), 0.0, 0.0],
        )  # fmt: skip
    return spec.compile()


def table_that_moves() -> mujoco.MjModel:
    """As it stands in the cell: the arm on the floor, the body ``plate`` on its two axes."""
    spec = mujoco.MjSpec.from_file(str(qt.load_task("deburring").scene))
    frame = spec.worldbody.add_body(name="frame", pos=CENTRE)
    frame.add_joint(name="tilt", axis=[1.0, 0.0, 0.0])
    plate = frame.add_body(name="plate")
    plate.add_joint(name="turn", axis=[0.0, 0.0, 1.0])
    for body in (frame, plate):
        body.mass, body.inertia, body.explicitinertial = 1.0, np.ones(3), 1
    plate.add_site(name="path", pos=-CENTRE)
    return spec.compile()
