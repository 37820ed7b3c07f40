"""How a controller counts the joints of a model: signs, zero positions, coupling."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import mujoco
import numpy as np

from qp_twist.checks import Array
from qp_twist.errors import InvalidInput
from qp_twist.kinematics import JointRanges
from qp_twist.kinematics.serial_chain import Screw
from qp_twist.robots.axis_geometry import Line, axis_geometry
from qp_twist.robots.controller_arm import ControllerArm
from qp_twist.robots.external_axes import PER_UNIT, ExternalAxis
from qp_twist.robots.known_robots import KnownRobot, hinges_of
from qp_twist.robots.tool_chain import ToolChain

_STEP = np.pi / 2.0
"""Zero positions of models and controllers differ by multiples of this."""
_ROUNDED = np.radians(1.0)
"""Difference from such a multiple that counts as rounding or calibration of the model, as in the
comparison of the axes."""
_TOLD = np.radians(0.01)
"""Such a difference above which there is a note."""
_OUTSIDE_DEG = 0.01
"""Violation from which an angle counts as outside the robot's range."""


@dataclass(frozen=True, eq=False)
class ControllerJoints:
    r"""What a controller shows for the joints of a model.

    .. math:: \theta_i = s_i q_i + o_i, \qquad
        \phi_i = \theta_i + c\,\theta_j \text{ for the coupled axis } i,\ \phi_i = \theta_i
        \text{ else}

    θ is the angle of an axis to the link before it, φ what the controller shows: the J3 of most
    Fanucs is the angle of the forearm to the floor (c = −1).

    Attributes:
        joint_names: The model's joints in the order of the controller's axes; external axes last.
        signs: s, ±1, (n,).
        offsets: o, rad; m of external slides, (n,).
        coupling: (i, j, c), axes counted from 1; ``None`` without.
        range_deg: Range of each θ, degrees; ``None`` where unknown.
        robot: Name of the robot; empty where joints are taken as the model has them.
        program: Language of the controller; ``None`` if it has none of those that are written, or
            any where joints are taken as the model has them.
        source: Source of the figures.
        notes: Remarks about the model.
        external: The external axes.
        tool: What moves the task's frame; ``None`` where it is not known.
        arm: Base, flange and configurations of a known robot, with external axes at the model's
            reference, in the frame in which the path is; ``None`` of one that holds the part.
    """

    joint_names: tuple[str, ...]
    signs: Array
    offsets: Array
    coupling: tuple[int, int, float] | None = None
    range_deg: tuple[tuple[float, float], ...] | None = None
    robot: str = ""
    program: str | None = None
    source: str = ""
    notes: tuple[str, ...] = ()
    external: tuple[ExternalAxis, ...] = ()
    tool: ToolChain | None = None
    arm: ControllerArm | None = None

    @classmethod
    def as_modelled(cls, joint_names: Sequence[str]) -> ControllerJoints:
        """Zero positions and signs of the model itself."""
        count = len(joint_names)
        return cls(tuple(joint_names), np.ones(count), np.zeros(count))

    @classmethod
    def of_robot(cls, robot: KnownRobot, joint_names: Sequence[str]) -> ControllerJoints:
        """Joints of a model that already counts as the robot does, up to the coupling.

        Raises:
            InvalidInput: If the numbers of joints and axes differ.
        """
        count = len(robot.lines)
        if len(joint_names) != count:
            raise InvalidInput(
                f"the {robot.name} has {count} axes, but there are {len(joint_names)} joints: "
                f"{', '.join(joint_names)}."
            )
        return cls(
            tuple(joint_names), np.ones(count), np.zeros(count), robot.coupling, robot.range_deg,
            robot.name, robot.program, robot.source,
        )  # fmt: skip

    def with_external(self, axes: Sequence[ExternalAxis]) -> ControllerJoints:
        """The same with these external axes."""
        count = self.robot_axes
        return replace(
            self,
            joint_names=(*self.joint_names[:count], *(each.joint for each in axes)),
            signs=np.append(self.signs[:count], [each.sign for each in axes]),
            offsets=np.append(self.offsets[:count], [each.offset for each in axes]),
            external=tuple(axes),
        )

    def with_tool(self, tool: ToolChain, robot: KnownRobot | None) -> ControllerJoints:
        """The same with what moves the task's frame, and the robot if it is known."""
        alone, arm = tool.arm, None
        order = [self.joint_names.index(name) for name in alone.names]
        if robot is not None and order == list(range(len(robot.lines))):
            arm = ControllerArm.of(robot, alone, self.signs[order], self.offsets[order])
        return replace(self, tool=tool, arm=arm)

    @property
    def robot_axes(self) -> int:
        """Number of axes of the robot itself."""
        return len(self.joint_names) - len(self.external)

    def scale(self, unit: str) -> Array:
        """What the controller shows for one rad or m of each joint, in ``unit`` and mm, (n,)."""
        return np.array([PER_UNIT[each] for each in self._units(unit)])

    def _units(self, unit: str) -> list[str]:
        """In which each axis is shown, those of the robot in ``unit``."""
        return [unit] * self.robot_axes + [each.unit for each in self.external]

    @property
    def origin(self) -> str:
        """Whose zero positions and signs these are, in a few words."""
        if not self.robot:
            return "joints as the model counts them"
        return f"joints as the {self.robot} counts them"

    def shown(self, q: Array) -> Array:
        """φ for joint positions q (N, n), rad."""
        return self._coupled(self.signs * q + self.offsets, 1.0)

    def shown_rates(self, rates: Array) -> Array:
        """The time derivative of φ for that of q, (N, n), rad/s."""
        return self._coupled(self.signs * rates, 1.0)

    def positions(self, shown: Array) -> Array:
        """q for what the controller shows, (N, n), rad."""
        return (self._coupled(shown, -1.0) - self.offsets) * self.signs

    def rates(self, shown: Array) -> Array:
        """The time derivative of q for that of φ, (N, n), rad/s."""
        return self._coupled(shown, -1.0) * self.signs

    def _coupled(self, angles: Array, sense: float) -> Array:
        if self.coupling is None:
            return angles
        i, j, factor = self.coupling
        coupled = angles.copy()
        coupled[:, i - 1] += sense * factor * angles[:, j - 1]
        return coupled

    def equations(self, axis_names: Sequence[str]) -> tuple[str, ...]:
        """What each axis shows, e.g. ``"A2 = -joint_2 - 90 deg"``."""
        texts, units = [], self._units("deg")
        for k, (name, joint) in enumerate(zip(axis_names, self.joint_names, strict=True)):
            text = f"{name} = {'-' if self.signs[k] < 0.0 else ''}{joint}"
            terms = [(PER_UNIT[units[k]] * float(self.offsets[k]), "")]
            if self.coupling is not None and self.coupling[0] == k + 1:
                terms.append((self.coupling[2], axis_names[self.coupling[1] - 1]))
            for value, of in terms:
                if round(value, 3):
                    size = of if of and abs(value) == 1.0 else f"{abs(value):.7g} {of or units[k]}"
                    text += f" {'-' if value < 0.0 else '+'} {size}"
            texts.append(text if k < self.robot_axes else f"{text} in {units[k]}")
        return tuple(texts)

    def outside(self, q: Array) -> str:
        """Where joint positions (N, n) leave the robot's range first, as a sentence; else empty."""
        if self.range_deg is None:
            return ""
        count = self.robot_axes
        theta = np.degrees(self.signs[:count] * q[:, :count] + self.offsets[:count])
        low, high = np.array(self.range_deg).T
        out = (theta < low - _OUTSIDE_DEG) | (theta > high + _OUTSIDE_DEG)
        if not out.any():
            return ""
        row, axis = (int(x) for x in np.argwhere(out)[0])
        return (
            f"row {row + 1}: axis {axis + 1} ({self.joint_names[axis]}) would be at "
            f"{theta[row, axis]:.7g}°, outside {low[axis]:g}° to {high[axis]:g}° of the "
            f"{self.robot}"
        )


def controller_joints(
    model: mujoco.MjModel, frame_name: str | int, frame_type: str, robot: KnownRobot
) -> ControllerJoints:
    """How the controller of a robot counts the joints of a model of it.

    The axes of the model are compared with those of the robot at its controller's zero positions:
    the signs are those with which the invariants of the axes agree, the offsets the differences of
    the angles between their common normals. Axes alone do not determine everything:

    * the zero of the first and of the last axis, which is taken from the model;
    * which way is up for an arm whose first axes intersect: that of the base's z axis;
    * which of two wrist configurations of one pose is zero: the one with the smaller offsets.

    Args:
        model: The scene.
        frame_name: A frame at the end of the arm, or on a tool.
        frame_type: ``"body"``, ``"site"`` or ``"geom"``.
        robot: The robot.

    Raises:
        InvalidInput: If the arm's axes are not those of the robot, or leave signs open.
    """
    screws = hinges_of(model, frame_name, frame_type)[-len(robot.lines) :]
    choices = _choices(screws, robot)
    if not choices:
        raise InvalidInput(
            f"the axes of the arm that carries {frame_name!r} are not those of the {robot.name} "
            "(distances, angles and offsets between its axes); check the robot's name, or the "
            "model."
        )
    up = _counts_up(model, screws[0], robot)
    choices = [choice for choice in choices if choice[0][0] == up] or choices
    choices.sort(key=lambda choice: float(np.abs(choice[1]).sum()))
    (signs, offsets), *others = choices
    least = np.abs(offsets).sum()
    if others and np.abs(others[0][1]).sum() - least < _ROUNDED:
        raise InvalidInput(
            f"the axes of the {robot.name} leave open which way the joints of this model count."
        )
    names = JointRanges.of(model).names
    joints = tuple(names[screw.dof] for screw in screws)
    whole = _STEP * np.round(offsets / _STEP)
    near = np.abs(offsets - whole) < _ROUNDED
    off = np.where(near, np.abs(offsets - whole), 0.0)
    notes = [
        f"{joint}: the model's axes differ by {np.degrees(by):.2g}° from those of the "
        f"{robot.name}, which counts as calibration: the zero position is the controller's"
        for joint, by in zip(joints, off, strict=True)
        if by > _TOLD
    ]
    return ControllerJoints(
        joints, signs, np.where(near, whole, offsets), robot.coupling, robot.range_deg,
        robot.name, robot.program, robot.source, tuple(notes),
    )  # fmt: skip


def _counts_up(model: mujoco.MjModel, first: Screw, robot: KnownRobot) -> float:
    """The sign with which the first joint counts as the robot's, by the base's z axis; 0 if open.

    The frame of an arm's base has its z axis upwards, along the first axis; the world's need not.
    """
    body = int(model.dof_bodyid[first.dof])
    base = int(model.body_parentid[body])
    if base == 0:
        return 0.0
    data = mujoco.MjData(model)
    data.qpos[:] = model.qpos0
    mujoco.mj_kinematics(model, data)
    along = float(data.xmat[base].reshape(3, 3)[:, 2] @ first.axis)
    if abs(along) < np.cos(_ROUNDED):
        return 0.0
    return float(np.sign(along * robot.lines[0].axis[2]))


def _choices(screws: Sequence[Screw], robot: KnownRobot) -> list[tuple[Array, Array]]:
    """Signs and offsets, rad, with which the model's axes are those of the robot."""
    lines = [Line(screw.axis, screw.anchor) for screw in screws]
    reference = np.array([screw.reference for screw in screws])
    found = []
    if len(lines) == len(robot.lines):
        for signs, here in axis_geometry(lines).orientations():
            if here.is_like(robot.geometry):
                offsets = np.zeros(len(lines))
                offsets[1:-1] = here.angles - robot.geometry.angles
                offsets[1:-1] -= (signs * reference)[1:-1]
                # Into −180° to 180°, the upper end included despite rounding.
                offsets = -((-offsets + np.pi + 1e-9) % (2.0 * np.pi) - np.pi - 1e-9)
                found.append((signs, offsets))
    return found
