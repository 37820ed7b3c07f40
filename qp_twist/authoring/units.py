"""Refuse a robot or a toolpath that is probably in another unit: their sizes are compared."""

from __future__ import annotations

import mujoco
import numpy as np

from qp_twist.authoring.frame_choice import FrameChoice
from qp_twist.authoring.request import Request
from qp_twist.constraints.colliding_pairs import body_name
from qp_twist.errors import InvalidInput
from qp_twist.kinematics import JointRanges, SerialChain, largest_reach
from qp_twist.paths import Toolpath, UnitQuestion

_FAR = 10.0
"""Distance of a path, in reaches of the robot, from which its unit is questioned."""
_LONG, _SHORT = 20.0, 0.02
"""Lengths of an arm, m, beyond which its unit is questioned if the path has another size."""
_OTHER_SIZE = 100.0
"""Ratio of the sizes of arm and path from which these are of another size."""
_WIDE = 20.0
"""Size of a link's mesh, in lengths of the arm, from which its unit is questioned."""


def refuse_other_units(
    request: Request, model: mujoco.MjModel, frame: FrameChoice, toolpath: Toolpath
) -> None:
    """Refuse sizes of robot, meshes and path that do not belong together.

    Args:
        request: The files and options.
        model: The robot.
        frame: The controlled frame.
        toolpath: The path, as read.

    Raises:
        InvalidInput: If the arm is of another order of magnitude than the path, a mesh than its
            arm, or the path is many times the robot's reach away. The message asks for the unit.
    """
    chain = SerialChain.of(model, frame.name, frame.kind)
    if not chain.screws:
        return
    points = np.array([*(screw.anchor for screw in chain.screws), chain.position])
    length = float(np.linalg.norm(np.diff(points, axis=0), axis=1).sum())
    _refuse_arm(request, frame, toolpath, length)
    _refuse_meshes(request, model, length)
    reach = largest_reach(chain, JointRanges.of(model))
    if np.isfinite(reach):
        _refuse_far(request, toolpath, chain, reach)


def _refuse_arm(request: Request, frame: FrameChoice, toolpath: Toolpath, length: float) -> None:
    """Refuse an arm of a length, m, that no arm has, and with which the path does not agree."""
    placed = (request.place or (0.0,) * 3, (request.tool_at or (0.0,) * 3)[:3])
    positions = np.concatenate([curve.positions for curve in toolpath.curves])
    path = max(float(np.abs(at).max()) for at in (positions, *placed))
    long = length > _LONG and length > _OTHER_SIZE * path
    short = length < _SHORT and path > _OTHER_SIZE * length
    if long or short:
        is_it = (
            f"is {request.robot.name} in mm?"
            if long
            else f"were the lengths of {request.robot.name} divided by 1000?"
        )
        raise InvalidInput(
            f"{request.robot}: from its first joint to {frame.name} the arm is {length:.3g} m "
            f"long, and the coordinates of {request.toolpath.name} are up to {path:.3g} m: "
            f"{is_it} MJCF and URDF are in metres; change the robot's file, its meshes, too. If "
            "the sizes are right, give by --place where the path is."
        )


def _refuse_meshes(request: Request, model: mujoco.MjModel, length: float) -> None:
    """Refuse a colliding mesh on a moving link that is many times as large as the arm."""
    meshes = model.geom_type == mujoco.mjtGeom.mjGEOM_MESH
    moving = model.body_weldid[model.geom_bodyid] != 0
    collides = (model.geom_contype != 0) | (model.geom_conaffinity != 0)
    sizes = np.where(meshes & moving & collides, 2.0 * model.geom_aabb[:, 3:].max(axis=1), 0.0)
    geom = int(np.argmax(sizes)) if len(sizes) else -1
    if geom >= 0 and sizes[geom] > _WIDE * length > 0.0:
        raise InvalidInput(
            f"{request.robot}: the mesh of {body_name(model, int(model.geom_bodyid[geom]))} is "
            f"{sizes[geom]:.3g} m across, and the arm {length:.3g} m long: is the mesh in mm? "
            'Write scale="0.001 0.001 0.001" beside its file name in the robot\'s file.'
        )


def _refuse_far(request: Request, toolpath: Toolpath, chain: SerialChain, reach: float) -> None:
    """Refuse a unit with which the path is many times the robot's reach away from it.

    The size of the path is checked when the task is loaded.
    """
    in_hand = request.tool_at is not None
    if request.place is not None or request.length_unit is not None or in_hand:
        return
    positions = np.concatenate([curve.positions for curve in toolpath.curves])
    apart = float(np.linalg.norm(positions - chain.screws[0].anchor, axis=1).min())
    largest = float(np.abs(positions).max())
    question = UnitQuestion.of(
        toolpath.unit, largest, 2.0 * reach, unit_in_file=toolpath.unit_in_file
    )
    if apart > _FAR * reach and question.likely is not None:
        raise InvalidInput(
            f"{request.toolpath.name}: its coordinates reach {largest:.3g} m, and the robot "
            f"{reach:.3g} m at most: {question.text}. If it is in {toolpath.unit}, say "
            f"--unit {toolpath.unit}, or --place where it stands."
        )
