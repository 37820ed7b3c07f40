"""Move the workpiece of a path, or tilt its tool."""

from __future__ import annotations

import copy
import dataclasses

import mink
import mujoco
import numpy.typing as npt

from qp_twist.checks import Array, finite_array
from qp_twist.errors import InvalidInput
from qp_twist.kinematics.frame import body_of
from qp_twist.paths.orientation import lean_turns, poses, roll_by_plane
from qp_twist.paths.path_task import PathTask


def placed(
    path_task: PathTask,
    rotation: mink.SO3,
    point: npt.ArrayLike,
    to: npt.ArrayLike,
    body: str | None = None,
) -> PathTask:
    """The path with its workpiece rotated about a point, and the point moved.

    The roll rule refers to the robot's base, so it is applied again. ``body`` names the workpiece's
    body in the scene, fixed to the world, which is moved too; the ``point`` is in the world at the
    task's placement, m.

    Raises:
        InvalidInput: If a vector is invalid, there is no such body, the path lies on a body that
            moves, with ``body``, or the roll rule is undefined for an axis.
    """
    about, there = finite_array("point", point, (3,)), finite_array("to", to, (3,))
    turn = rotation.as_matrix()
    rotations = turn @ path_task.poses[0]
    positions = there + (path_task.positions - about) @ turn.T
    if body is not None:
        path_task = _with_body_moved(path_task, body, rotation, about, there)
    return _with_poses(path_task, positions, rotations)


def base_moved(path_task: PathTask, rotation: mink.SO3, shift: npt.ArrayLike) -> PathTask:
    """The task of the robot whose base is turned about its own origin, and shifted, (3,), m.

    The path stays; so do the scene's other bodies. The roll rule turns with the base.

    Raises:
        InvalidInput: If a vector is invalid, or the path lies on a body that joints move.
    """
    if path_task.relative_to is not None:
        raise InvalidInput(
            f"{path_task.name}: the path lies on {path_task.relative_to!r}, which joints move "
            "against the base; place the path on it instead."
        )
    model = path_task.model
    base = int(model.body_rootid[body_of(model, path_task.frame_name, path_task.frame_type)])
    at = model.body_pos[base].copy()
    moved = _body_moved(path_task, base, rotation, at, at + finite_array("shift", shift, (3,)))
    if path_task.roll_normal is None:
        return moved
    moved = dataclasses.replace(moved, roll_normal=rotation.apply(path_task.roll_normal))
    rotations, positions = path_task.poses
    return _with_poses(moved, positions, rotations)


def _with_body_moved(
    path_task: PathTask, body: str, rotation: mink.SO3, point: Array, to: Array
) -> PathTask:
    if path_task.relative_to is not None:
        raise InvalidInput(
            f"{path_task.name}: the path lies on {path_task.relative_to!r}, which joints move; it "
            "can be placed elsewhere on that body, but no body is moved along. Leave body out."
        )
    model = path_task.model
    number = mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_BODY, body)
    if number < 1 or model.body_parentid[number] != 0 or model.body_jntnum[number]:
        raise InvalidInput(
            f"{path_task.name}: a workpiece that moves along is a body fixed to the world; "
            f"{path_task.scene.name} has no such body {body!r}."
        )
    return _body_moved(path_task, number, rotation, point, to)


def _body_moved(
    path_task: PathTask, number: int, rotation: mink.SO3, point: Array, to: Array
) -> PathTask:
    """With a child of the world turned about a point, and the point moved."""
    model = copy.copy(path_task.model)
    model.body_pos[number] = to + rotation.apply(model.body_pos[number] - point)
    model.body_quat[number] = (rotation @ mink.SO3(model.body_quat[number])).wxyz
    return dataclasses.replace(path_task, model=model)


def leaned(path_task: PathTask, lead: float, tilt: float) -> PathTask:
    """The path with its tool tilted towards its direction (``lead``) and to its left, rad.

    The tilt is constant relative to the path (:func:`~qp_twist.paths.orientation.lean_turns`).

    Raises:
        InvalidInput: If the path is parallel to the tool's axis everywhere.
    """
    rotations, positions = path_task.poses
    turns = lean_turns(path_task.name, positions, rotations[:, :, 2], lead, tilt)
    return _with_poses(path_task, positions, turns @ rotations)


def _with_poses(path_task: PathTask, positions: Array, rotations: Array) -> PathTask:
    normal = path_task.roll_normal
    if normal is None:
        return dataclasses.replace(path_task, waypoints=poses(positions, rotations))
    axes = rotations[:, :, 2]
    return dataclasses.replace(
        path_task,
        waypoints=poses(positions, roll_by_plane(axes, normal)),
        flipped_waypoints=poses(positions, roll_by_plane(axes, normal, flip=True)),
    )
