"""A robot from an MJCF or URDF file."""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import mujoco

from qp_twist.errors import InvalidInput
from qp_twist.files import check_regular, read_bytes
from qp_twist.robots.finite import not_computable
from qp_twist.robots.urdf import read_urdf


@dataclass(frozen=True, eq=False)
class Robot:
    """A robot from a file.

    Attributes:
        model: MuJoCo's model of the robot.
        velocity_limits: Largest joint speeds by joint name, rad/s or m/s: those of a URDF above 0;
            empty for MJCF.
        left_out: A sentence for each part of the file that is missing in the model.
        path: The file.
        spec: What the model was compiled from, for scenes that add something to it.

    Example:
        >>> import qp_twist as qt
        >>> robot = qt.load_robot(qt.load_task("planar_line").scene)
        >>> robot
        Robot('planar_3r.xml', 3 joints)
        >>> limit = qt.MotionLimit(robot.model, velocity=robot.velocity_limits)
    """

    model: mujoco.MjModel
    velocity_limits: dict[str, float]
    left_out: tuple[str, ...]
    path: Path
    spec: mujoco.MjSpec

    def __repr__(self) -> str:
        count = int(self.model.njnt)
        joints = f"{count} joint{'' if count == 1 else 's'}"
        lacks = f", left out: {len(self.left_out)}" if self.left_out else ""
        return f"Robot({self.path.name!r}, {joints}{lacks})"


def load_robot(
    path: str | Path,
    *,
    packages: Mapping[str, str | Path] | None = None,
) -> Robot:
    """Load a robot from an MJCF or a URDF file, distinguished by the root element.

    Both are loaded by MuJoCo; in a URDF every link remains a body, also one on a fixed joint, such
    as ``tool0``. Parts of a URDF that MuJoCo refuses but kinematics does not need are left out and
    listed in ``left_out``: missing or unreadable meshes, unphysical masses and inertias.

    Args:
        path: The file.
        packages: Folders of the ROS packages with a URDF's meshes, by name. Other packages are
            searched beside the file and beside each of its parent folders.

    Raises:
        InvalidInput: If there is no such file, it is neither MJCF nor URDF, it contradicts itself,
            a number in it is NaN or infinite, or its robot has no joint.
    """
    file, folders = _file(path), _folders(packages)
    text = _text(file)
    root = _root_element(text)
    if root == "mujoco":
        spec, model = _mjcf(file)
        robot = Robot(model, {}, (), file, spec)
    elif root == "robot":
        spec, model, speeds, left_out = read_urdf(text, file, folders)
        robot = Robot(model, speeds, left_out, file, spec)
    else:
        found = f"starts with <{root}>" if root else "is empty or no XML at all"
        raise InvalidInput(
            f"{file}: expected an MJCF (<mujoco>) or a URDF (<robot>), but the file {found}; "
            "give a robot in one of the two formats."
        )
    if wrong := not_computable(robot.model):
        raise InvalidInput(
            f"{file}: {wrong} cannot be computed with; expected finite numbers, up to 1e10. Mend "
            "it in the file."
        )
    if robot.model.njnt == 0:
        raise InvalidInput(f"{file}: the robot has no joint that moves; give one that has.")
    return robot


def _mjcf(file: Path) -> tuple[mujoco.MjSpec, mujoco.MjModel]:
    try:
        spec = mujoco.MjSpec.from_file(str(file))
        return spec, spec.compile()
    except ValueError as error:
        reason = " ".join(str(error).split())
        raise InvalidInput(f"{file}: MuJoCo cannot load this MJCF: {reason}") from error


def _file(path: str | Path) -> Path:
    if not isinstance(path, (str, Path)):
        raise InvalidInput(f"path: expected a str or a Path, got {type(path).__name__}.")
    file = Path(path)
    check_regular(file, "MJCF or URDF file")
    return file


def _folders(packages: Mapping[str, str | Path] | None) -> dict[str, Path]:
    if packages is None:
        return {}
    if not isinstance(packages, Mapping):
        raise InvalidInput(
            f"packages: expected folders by package name, got {type(packages).__name__}."
        )
    folders = {name: Path(folder) for name, folder in packages.items()}
    for name, folder in folders.items():
        if not folder.is_dir():
            raise InvalidInput(f"packages.{name}: there is no folder {folder}; check the path.")
    return folders


def _text(file: Path) -> str:
    """The file without comments, with the same lines: MuJoCo allows comments that are not XML."""
    text = read_bytes(file).decode("utf-8-sig", errors="replace")
    return re.sub(r"<!--.*?-->", lambda comment: "\n" * comment[0].count("\n"), text, flags=re.S)


def _root_element(text: str) -> str:
    """Name of the first element, or ``""``."""
    start = re.match(r"\s*(?:<[?!][^>]*>\s*)*<([A-Za-z_][\w:.-]*)", text)
    return start[1] if start else ""
