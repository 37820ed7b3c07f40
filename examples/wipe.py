"""A 7R arm wipes a table. A ball comes near: elbow and stroke give way, the contact does not."""

from pathlib import Path

import mink
import mujoco
import numpy as np
from app import DT, off, run

import qp_twist as qt

SCENE = Path(__file__).parents[1] / "scenes" / "arm_and_table.xml"
model = mujoco.MjModel.from_xml_path(str(SCENE))
configuration = mink.Configuration(model, np.array([0.0, 0.5, 0.0, -1.5, 0.0, 1.14, 0.0]))
table = configuration.get_transform_frame_to_world("table", "site")
downwards = mink.SE3.from_rotation(mink.SO3.from_x_radians(np.pi))  # the tool's z into the table

contact = qt.TwistTask.on_plane("arm_tool", "site", flat=True)  # height and two tilts: three rows
stroke = qt.TwistTask(  # where on the table: two rows more, less important
    "arm_tool",
    "site",
    qt.TwistProjector(
        linear=qt.Projector.plane([0, 0, 1]), angular=qt.Projector.none(), frame="target"
    ),
    max_linear_step=0.005,
)
arm = ["arm_upper_arm", "arm_forearm", "arm_wrist"]
limits = [
    qt.MotionLimit(model, velocity=1.5),
    mink.CollisionAvoidanceLimit(
        model,
        [(arm, ["ball"])],
        minimum_distance_from_collisions=0.03,
        collision_detection_distance=0.3,
        gain=0.2,
    ),
]
controller = qt.Controller(
    model,
    levels=[[contact], [stroke]],
    secondary=[qt.PostureReference(model, configuration.q, gain=0.02)],
    limits=limits,
)
ball = model.body("ball").mocapid[0]
heights, strokes, distances = [], [], []


def wiped(t: float) -> mink.SE3:
    x, y = 0.08 * np.sin(0.4 * t), 0.25 * np.sin(2.0 * t)
    return table @ mink.SE3.from_translation(np.array([x, y, 0.0])) @ downwards


def step(t: float) -> None:
    configuration.data.mocap_pos[ball] = [0.38, 0.8 - 0.7 * np.sin(0.6 * t) ** 2, 0.45]
    configuration.update()
    now, then = wiped(t), wiped(t + DT)
    contact.set_target(then)
    stroke.set_target(now, qt.target_twist(now, then, DT))
    configuration.integrate_inplace(controller.step(configuration, DT).velocity, DT)
    if t > 1.0:  # once it is on the table
        heights.append(off(contact, configuration))
    stroke.set_target(then)
    strokes.append(off(stroke, configuration))
    distances.append(
        min(
            mujoco.mj_geomDistance(
                model, configuration.data, model.geom(g).id, model.geom("ball").id, 1.0, None
            )
            for g in arm
        )
    )


run(configuration, step, lasts=20.0)
print(f"off the table by at most {max(heights, default=0.0):.1e} (m, rad)")
print(f"stroke given up by at most {1e3 * max(strokes[100:], default=0.0):.0f} mm")
print(f"never nearer to the ball than {1e3 * min(distances):.0f} mm")
