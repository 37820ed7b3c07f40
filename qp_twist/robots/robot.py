"""A robot from an MJCF, URDF or xacro file."""

from __future__ import annotations

import codecs
import re
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import mujoco

from qp_twist.errors import InvalidInput
from qp_twist.files import check_regular, file_path, is_folder, own_exceptions, read_bytes
from qp_twist.robots.finite import not_computable
from qp_twist.robots.urdf import read_urdf
from qp_twist.robots.wording import reason_of
from qp_twist.robots.xacro_files import expanded, is_xacro


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
    arguments: Mapping[str, str | bool | int | float] | None = None,
) -> Robot:
    """Load a robot from an MJCF, a URDF or a xacro file, distinguished by what is in it.

    Both are loaded by MuJoCo; in a URDF every link remains a body, also one on a fixed joint, such
    as ``tool0``. Parts of a URDF that MuJoCo refuses but kinematics does not need are left out and
    listed in ``left_out``: missing or unreadable meshes, unphysical masses and inertias.

    Args:
        path: The file.
        packages: Folders of the ROS packages with a URDF's meshes, or that a xacro file includes,
            by name. Other packages are searched around the file and its parent folders.
        arguments: Values of the ``<xacro:arg>`` of a xacro file, by name.

    Raises:
        InvalidInput: If there is no such file, it is neither MJCF nor URDF, it contradicts itself,
            a number in it is NaN or infinite, or its robot has no joint.
    """
    file, folders, values = _file(path), _folders(packages), _values(arguments)
    with own_exceptions(file):
        robot = _read(file, folders, values)
    if wrong := not_computable(robot.model):
        raise InvalidInput(
            f"{file}: {wrong} cannot be computed with; expected finite numbers, up to 1e10. Mend "
            "it in the file."
        )
    if robot.model.njnt == 0:
        raise InvalidInput(f"{file}: the robot has no joint that moves; give one that has.")
    return robot


def _read(file: Path, folders: Mapping[str, Path], values: Mapping[str, str]) -> Robot:
    text = _text(file)
    root = _root_element(text)
    if root == "mujoco" and values:
        raise InvalidInput(f"{file}: is no xacro file and has no arguments; leave them out.")
    if root == "mujoco":
        spec, model = _mjcf(file)
        return Robot(model, {}, (), file, spec)
    if root == "robot":
        said: list[str] = []
        if is_xacro(text, file):
            text, said = expanded(file, folders, values)
        elif values:
            raise InvalidInput(f"{file}: is no xacro file and has no arguments; leave them out.")
        spec, model, speeds, left_out = read_urdf(text, file, folders)
        return Robot(model, speeds, (*said, *left_out), file, spec)
    found = f"starts with <{root}>" if root else "is empty or no XML at all"
    raise InvalidInput(
        f"{file}: expected an MJCF (<mujoco>) or a URDF (<robot>), but the file {found}; give a "
        "robot in one of the two formats."
    )


def _mjcf(file: Path) -> tuple[mujoco.MjSpec, mujoco.MjModel]:
    try:
        spec = mujoco.MjSpec.from_file(str(file))
        return spec, spec.compile()
    except ValueError as error:
        raise InvalidInput(f"{file}: MuJoCo cannot load this MJCF: {reason_of(error)}") from error


def _file(path: str | Path) -> Path:
    file = file_path("path", path)
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
        if not is_folder(folder):
            raise InvalidInput(f"packages.{name}: there is no folder {folder}; check the path.")
    return folders


def _values(arguments: Mapping[str, str | bool | int | float] | None) -> dict[str, str]:
    if arguments is None:
        return {}
    if not isinstance(arguments, Mapping):
        raise InvalidInput(f"arguments: expected values by name, got {type(arguments).__name__}.")
    # xacro reads true and false as XML has them.
    return {
        str(name): str(value).lower() if isinstance(value, bool) else str(value)
        for name, value in arguments.items()
    }


def _text(file: Path) -> str:
    """The file without comments, with the same lines: MuJoCo allows comments that are not XML."""
    content = read_bytes(file)
    text = content.decode(_encoding(content), errors="replace").removeprefix("\ufeff")
    return re.sub(r"<!--.*?-->", lambda comment: "\n" * comment[0].count("\n"), text, flags=re.S)


def _encoding(content: bytes) -> str:
    """The encoding of an XML file: by its byte order mark, or as declared."""
    if content.startswith((codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE)):
        return "utf-16"
    declared = re.match(rb"\s*<\?xml[^>]*?\bencoding\s*=\s*[\"']([\w.-]+)", content)
    try:
        return codecs.lookup("utf-8" if declared is None else declared[1].decode()).name
    except LookupError:
        return "utf-8"


def _root_element(text: str) -> str:
    """Name of the first element, or ``""``."""
    start = re.match(r"\s*(?:<[?!][^>]*>\s*)*<([A-Za-z_][\w:.-]*)", text)
    return start[1] if start else ""
