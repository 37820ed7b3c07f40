"""Arms of four and five joints whose models may have rounded angles, and a path for them."""

import dataclasses
import math
from typing import Any

import mink
import mujoco
import numpy as np

import qp_twist as qt

AXIS = qt.TwistProjector(
    linear=qt.Projector.full(), angular=qt.Projector.plane([0, 0, 1]), frame="body"
)
SPHERE = '<geom type="sphere" size=".01" contype="0" conaffinity="0"/>'


def vertical_arm(angle: str, *, tip: str = SPHERE, scene: str = "") -> mujoco.MjModel:
    """A turret, an elbow and a wrist in its vertical plane, and a roll: five joints.

    ``tip``: shapes of the last link; ``scene``: what stands beside the arm.
    """
    return mujoco.MjModel.from_xml_string(f"""<mujoco><compiler angle="radian" autolimits="true"/>
 <worldbody>{scene}<body pos="0 0 .3"><joint name="turn" axis="0 0 1" range="-3 3"/>{SPHERE}
  <body><joint name="upper" axis="0 1 0" range="-1 1.2"/>{SPHERE}
   <body pos="0 0 .5"><joint name="fore" axis="0 1 0" range="-1.2 1.2"/>{SPHERE}
    <body pos=".5 0 0"><joint name="pitch" axis="0 1 0" range="-2.5 2.5"/>{SPHERE}
     <body><joint name="roll" axis="1 0 0" range="-3 3"/>{tip}
      <site name="tip" pos=".1 0 0" euler="0 {angle} 0"/></body></body></body></body></body>
 </worldbody></mujoco>""")


def scara(angle: str) -> mujoco.MjModel:
    """Two links that swing in a level plane, a spindle that sinks and turns: four joints."""
    return mujoco.MjModel.from_xml_string(f"""<mujoco><compiler angle="radian" autolimits="true"/>
 <worldbody><body pos="0 0 .8"><joint name="shoulder" axis="0 0 1" range="-2.5 2.5"/>{SPHERE}
  <body pos=".4 0 0"><joint name="elbow" axis="0 0 1" range="-2.4 2.4"/>{SPHERE}
   <body pos=".3 0 0"><joint name="sink" type="slide" axis="0 0 -1" range="0 .3"/>{SPHERE}
    <body><joint name="spin" axis="0 0 1" range="-6 6"/>{SPHERE}
     <site name="tip" pos="0 0 -.1" euler="{angle} 0 0"/></body></body></body></body>
 </worldbody></mujoco>""")


def axis_path(model: mujoco.MjModel, **changes: Any) -> qt.PathTask:
    """A straight line with the tool vertical, 11 waypoints."""
    down = mink.SO3.from_rpy_radians(math.pi, 0.0, 0.0)
    places = [np.array([0.45 + 0.01 * k, 0.02 * k, 0.62]) for k in range(11)]
    none = np.full(model.nv, np.inf)
    whole = qt.TwistProjector(linear=qt.Projector.full(), angular=qt.Projector.full())
    path_task = dataclasses.replace(
        qt.load_task("planar_line"), name="rounded", title="rounded", model=model,
        frame_name="tip", frame_type="site", projector=AXIS, operational=whole,
        waypoints=tuple(mink.SE3.from_rotation_and_translation(down, p) for p in places),
        flipped_waypoints=None, start=np.full(model.nq, 0.1), durations=None,
        velocity_limits=none, acceleration_limits=none, constraints=(), segments=(), bands=(),
        toolpath=None, lines=None,
    )  # fmt: skip
    return dataclasses.replace(path_task, **changes)
