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

    Raises:
        InvalidInput: If the arm is of another order of magnitude than the path, a mesh than its
            arm, or the path is many times the robot's reach away. The message asks for the unit.
    """
    chain = SerialChain.of(model, frame.name, frame.kind)
    if not chain.screws:
        return
    anchors = np.array([*(screw.anchor for screw in chain.screws), chain.position])
    length = float(np.linalg.norm(np.diff(anchors, axis=0), axis=1).sum())
    points = np.concatenate([curve.positions for curve in toolpath.curves])
    largest = float(np.abs(points).max())
    placed = (request.place or (0.0,) * 3, (request.tool_at or (0.0,) * 3)[:3])
    path = max(largest, *(float(np.abs(at).max()) for at in placed))
    if (length > _LONG and length > _OTHER_SIZE * path) or (
        length < _SHORT and path > _OTHER_SIZE * length
    ):
        raise InvalidInput(
            f"{request.robot}: from its first joint to {frame.name} the arm is {length:.3g} m "
            f"long, and the coordinates of {request.toolpath.name} are up to {path:.3g} m: is one "
            "of the two in another unit? MJCF and URDF are in metres, their meshes, too. If the "
            "sizes are right, give by --place where the path is."
        )
    # The largest mesh that collides and moves.
    moving = model.body_weldid[model.geom_bodyid] != 0
    collides = (model.geom_contype != 0) | (model.geom_conaffinity != 0)
    meshes = (model.geom_type == mujoco.mjtGeom.mjGEOM_MESH) & moving & collides
    sizes = np.where(meshes, 2.0 * model.geom_aabb[:, 3:].max(axis=1), 0.0)
    if sizes.max(initial=0.0) > _WIDE * length > 0.0:
        geom = int(np.argmax(sizes))
        raise InvalidInput(
            f"{request.robot}: the mesh of {body_name(model, int(model.geom_bodyid[geom]))} is "
            f"{sizes[geom]:.3g} m across, and the arm {length:.3g} m long: is the mesh in mm? "
            'Write scale="0.001 0.001 0.001" beside its file name in the robot\'s file.'
        )
    reach = largest_reach(chain, JointRanges.of(model))
    stated = request.place is not None or request.length_unit is not None
    if stated or request.tool_at is not None or not np.isfinite(reach):
        return
    apart = float(np.linalg.norm(points - chain.screws[0].anchor, axis=1).min())
    question = UnitQuestion.of(
        toolpath.unit, largest, 2.0 * reach, unit_in_file=toolpath.unit_in_file
    )
    if apart > _FAR * reach and question.likely is not None:
        raise InvalidInput(
            f"{request.toolpath.name}: its coordinates reach {largest:.3g} m, and the robot "
            f"{reach:.3g} m at most: {question.text}. If it is in {toolpath.unit}, say "
            f"--unit {toolpath.unit}, or --place where it stands."
        )
