"""Pose and world-aligned Jacobian of a frame of the model, and its twist between two poses."""

from __future__ import annotations

from typing import Any

import mink
import mujoco
import numpy as np

from qp_twist.checks import Array, finite_array, instance, number
from qp_twist.errors import InvalidInput


def same_structure(one: mujoco.MjModel, other: mujoco.MjModel) -> bool:
    """Whether two models have the same joints, bodies, geoms and sites under the same ids.

    Then ids of the one are valid in the other; sizes and masses may differ.
    """
    if one is other:
        return True
    sizes = ("nq", "nv", "njnt", "nbody", "ngeom", "nsite")
    arrays = ("jnt_type", "jnt_bodyid", "body_parentid", "geom_bodyid", "site_bodyid")
    return (
        all(getattr(one, size) == getattr(other, size) for size in sizes)
        and one.names == other.names
        and all(np.array_equal(getattr(one, a), getattr(other, a)) for a in arrays)
    )


def check_configuration(configuration: mink.Configuration) -> None:
    """Refuse objects that are not configurations, or whose data belong to another model.

    Both are plain attributes that may be replaced, and MuJoCo does not check the data's sizes.
    """
    instance("configuration", configuration, mink.Configuration)
    # It may be any object, or none.
    model: Any = getattr(configuration, "model", None)
    data: Any = getattr(configuration, "data", None)
    instance("configuration.model", model, mujoco.MjModel)
    instance("configuration.data", data, mujoco.MjData)
    if not same_structure(data.model, model):
        raise InvalidInput(
            f"configuration.data belongs to a model with nq = {data.model.nq}, nv = "
            f"{data.model.nv} and {data.model.nbody} bodies, configuration.model has nq = "
            f"{model.nq}, nv = {model.nv} and {model.nbody}, or their names or joints differ; "
            "make a new mink.Configuration(model, q)."
        )


def check_frame(what: str, name: Any, frame_type: Any) -> None:
    """Refuse a name or id, or a type of frame, that no model can have."""
    if not isinstance(frame_type, str) or frame_type not in mink.SUPPORTED_FRAMES:
        raise mink.UnsupportedFrame(frame_type, mink.SUPPORTED_FRAMES)
    if isinstance(name, bool) or not isinstance(name, (str, int, np.integer)):
        raise InvalidInput(f"{what}: expected the name or the id of a {frame_type}, got {name!r}.")


def frame_id(model: mujoco.MjModel, name: str | int, frame_type: str) -> int:
    """Id of a body, geom or site; mink's errors name the types, or the names, that there are."""
    check_frame("frame", name, frame_type)
    if isinstance(name, str):
        found = mujoco.mj_name2id(model, mink.FRAME_TO_ENUM[frame_type], name)
        if found < 0:
            raise mink.InvalidFrame(name, frame_type, model)
        return int(found)
    count = {"body": model.nbody, "geom": model.ngeom, "site": model.nsite}[frame_type]
    if not 0 <= name < count:
        raise mink.InvalidFrame(int(name), frame_type, model)
    return int(name)


def frame_pose(
    configuration: mink.Configuration, name: str | int, frame_type: str
) -> tuple[Array, Array]:
    """Rotation (3, 3) of a frame to the world and its origin (3,) in the world, m."""
    check_configuration(configuration)
    index = frame_id(configuration.model, name, frame_type)
    data = configuration.data
    rotation = getattr(data, mink.FRAME_TO_XMAT_ATTR[frame_type])[index].reshape(3, 3).copy()
    position = getattr(data, mink.FRAME_TO_POS_ATTR[frame_type])[index].copy()
    return rotation, position


def frame_jacobian(configuration: mink.Configuration, name: str | int, frame_type: str) -> Array:
    r"""World-aligned Jacobian J of a frame, :math:`\mathbf t = \mathbf J \dot{\mathbf q}`, (6, nv).

    Rows are (linear, angular) in world axes, reference point the frame's origin (paper, eq. *t*).
    mink's ``get_frame_jacobian`` is the same with both blocks turned into the frame's own axes.
    """
    check_configuration(configuration)
    index = frame_id(configuration.model, name, frame_type)
    jacobian = np.empty((6, configuration.model.nv))
    mink.FRAME_TO_JAC_FUNC[frame_type](
        configuration.model, configuration.data, jacobian[:3], jacobian[3:], index
    )
    return jacobian


def relative_jacobian(
    configuration: mink.Configuration,
    name: str | int,
    frame_type: str,
    root: str | int,
    root_type: str,
) -> Array:
    r"""Jacobian (6, nv) of a frame relative to another moving frame, in world axes.

    .. math::

        \mathbf J = \mathbf J_A - \begin{bmatrix} \mathbf 1 & -[\mathbf p_A - \mathbf p_B]_\times \\
        \mathbf O & \mathbf 1 \end{bmatrix} \mathbf J_B

    The twist of A minus the twist that A would have if rigidly attached to B: zero if both move as
    one body.
    """
    jacobian = frame_jacobian(configuration, name, frame_type)
    carrier = frame_jacobian(configuration, root, root_type)
    arm = frame_pose(configuration, name, frame_type)[1]
    arm = arm - frame_pose(configuration, root, root_type)[1]
    # ω × r, column by column
    carrier[:3] += np.cross(carrier[3:], arm, axisa=0).T
    return jacobian - carrier


def together(
    model: mujoco.MjModel, name: str | int, frame_type: str, other: str | int, other_type: str
) -> bool:
    """Whether two frames are on bodies without a joint between them."""
    return welded_to(model, name, frame_type) == welded_to(model, other, other_type)


def welded_to(model: mujoco.MjModel, name: str | int, frame_type: str) -> int:
    """Id of the body that carries a frame, without joints between them; 0 if it stands still."""
    return int(model.body_weldid[body_of(model, name, frame_type)])


def body_of(model: mujoco.MjModel, name: str | int, frame_type: str) -> int:
    """Id of the body that a frame is fixed to."""
    index = frame_id(model, name, frame_type)
    owners = {"geom": model.geom_bodyid, "site": model.site_bodyid}
    return int(owners[frame_type][index]) if frame_type in owners else index


def target_twist(before: mink.SE3, now: mink.SE3, dt: float) -> Array:
    r"""Twist (6,) that moves a target from one pose to another in a time, for its feed-forward.

    .. math::

        \mathbf v = (\mathbf p - \mathbf p_{before})/dt, \qquad
        \boldsymbol\omega = \log(\mathbf R\mathbf R_{before}^T)/dt

    (linear, angular), in the axes of the poses, reference point the target's origin, m/s and rad/s.
    For a conveyor with a known motion, use its poses now and at the end of the step; for a tracked
    part, its last two poses.

    Raises:
        InvalidInput: If a pose is no ``mink.SE3`` or dt ≤ 0.

    Example:
        >>> import mink, numpy as np, qp_twist as qt
        >>> a, b = mink.SE3.identity(), mink.SE3.from_translation(np.array([0.001, 0.0, 0.0]))
        >>> qt.target_twist(a, b, 0.01)
        array([0.1, 0. , 0. , 0. , 0. , 0. ])
    """
    instance("target_twist(before, …)", before, mink.SE3)
    instance("target_twist(…, now)", now, mink.SE3)
    dt = number("dt", dt, above=0.0)
    for name, pose in (("before", before), ("now", now)):
        finite_array(f"target_twist: {name}", pose.wxyz_xyz, (7,))
    linear = now.translation() - before.translation()
    angular = (now.rotation() @ before.rotation().inverse()).log()
    return np.concatenate([linear, angular]) / dt
