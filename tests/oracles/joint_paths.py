"""Joint trajectories through given rows, with the task whose waypoints lie where they lead."""

import dataclasses
from pathlib import Path

import mink
import mujoco
import numpy as np

import qp_twist as qt

Array = np.ndarray
POSITION = qt.TwistProjector(linear=qt.Projector.full(), angular=qt.Projector.none())


def slider(joints: int = 1) -> mujoco.MjModel:
    """Slides along x, y, z with a site at the end: its position is q."""
    axes = ("1 0 0", "0 1 0", "0 0 1")
    opening = "".join(
        f'<body><joint name="slide_{i + 1}" type="slide" axis="{axes[i]}" range="-9 9"/>'
        '<geom size="0.1" mass="1"/>'
        for i in range(joints)
    )
    return mujoco.MjModel.from_xml_string(
        f'<mujoco><worldbody>{opening}<site name="tool"/>{"</body>" * joints}</worldbody></mujoco>'
    )


def joint_path(
    model: mujoco.MjModel,
    q: Array,
    durations: Array | None,
    velocity: float | Array = np.inf,
    acceleration: float | Array = np.inf,
    projector: qt.TwistProjector = POSITION,
) -> qt.Trajectory:
    """A trajectory through joint rows whose waypoints are where they lead."""
    configuration = mink.Configuration(model)
    waypoints = []
    for row in q:
        configuration.update(row)
        waypoints.append(configuration.get_transform_frame_to_world("tool", "site"))
    full = qt.TwistProjector(linear=qt.Projector.full(), angular=qt.Projector.full())
    task = qt.PathTask(
        name="rows", title="rows", source=None, scene=Path("rows.xml"), model=model,
        frame_name="tool", frame_type="site", projector=projector, operational=full,
        waypoints=tuple(waypoints), flipped_waypoints=None, start=q[0], durations=durations,
        velocity_limits=np.broadcast_to(velocity, model.nv).astype(float),
        acceleration_limits=np.broadcast_to(acceleration, model.nv).astype(float),
    )  # fmt: skip
    return qt.Trajectory(task, "qp", q, durations)


def evenly(count: int, duration: float) -> Array:
    return np.concatenate([[0.0], np.full(count - 1, duration)])


def short(task: qt.PathTask, count: int, **changes: object) -> qt.PathTask:
    return dataclasses.replace(task.part(slice(count)), **changes)


def between(q: Array, count: int = 50) -> Array:
    """Samples on the straight lines in joints, one after the other, (…, nv)."""
    shares = np.linspace(0.0, 1.0, count)[:, None]
    return (q[:-1, None] + shares * np.diff(q, axis=0)[:, None]).reshape(-1, q.shape[1])
