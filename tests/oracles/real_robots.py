"""Real robots from two packages that ship models, as far as these are installed.

Neither package is imported: only its folder is looked for.
"""

import importlib.util
from dataclasses import dataclass, field
from functools import cache
from pathlib import Path

import pytest

from qp_twist.robots import Robot, load_robot


@dataclass(frozen=True)
class RealRobot:
    """A model file in a package, and the frame of it that a task controls.

    Attributes:
        name: What tests call it.
        package: The Python package that has it: robosuite or rtbdata.
        file: Path in the package.
        frame: A body at the end of the arm.
        joints: How many joints the arm has, by its data sheet.
        meshes: Folders in the Python package by the name that the file has for them.
    """

    name: str
    package: str
    file: str
    frame: str
    joints: int
    meshes: dict[str, str] = field(default_factory=dict, compare=False)

    @property
    def folder(self) -> Path | None:
        """Folder of the Python package, or ``None`` where it is not installed."""
        spec = importlib.util.find_spec(self.package)
        places = spec.submodule_search_locations if spec is not None else None
        return Path(next(iter(places))) if places else None

    @property
    def path(self) -> Path:
        """The file; skips the test where it is not installed."""
        folder = self.folder
        if folder is None:
            wheel = {"robosuite": "robosuite==1.5.2", "rtbdata": "rtb-data==2.0.0"}[self.package]
            pytest.skip(f"{self.name} is not here: pip install --no-deps {wheel}")
        return folder / self.file

    def load(self) -> Robot:
        """The robot, loaded once in a process."""
        return _load(self)


@cache
def _load(robot: RealRobot) -> Robot:
    path = robot.path
    assert robot.folder is not None
    packages = {name: robot.folder / folder for name, folder in robot.meshes.items()}
    return load_robot(path, packages=packages)


def _robosuite(folder: str, joints: int) -> RealRobot:
    file = f"models/assets/robots/{folder}/robot.xml"
    return RealRobot(folder, "robosuite", file, "right_hand", joints)


def _kuka(folder: str, model: str, joints: int) -> RealRobot:
    place = f"xacro/kuka_description/{folder}"
    file = f"{place}/urdf/{model}.urdf"
    return RealRobot(model, "rtbdata", file, "tool0", joints, {f"{folder}_support": place})


MJCF = (
    _robosuite("ur5e", 6), _robosuite("panda", 7), _robosuite("iiwa", 7), _robosuite("sawyer", 7),
    _robosuite("xarm7", 7), _robosuite("kinova3", 7), _robosuite("jaco", 7),
)  # fmt: skip
URDF = (
    RealRobot(
        "irb140", "rtbdata", "xacro/abb_irb140_description/urdf/irb140.urdf", "tool0", 6,
        {"abb_irb140_support": "xacro/abb_irb140_description"},
    ),
    _kuka("kuka_kr16", "kr16_2", 6),
    _kuka("kuka_kr120", "kr120r2500pro", 6),
    _kuka("kuka_kr210", "kr210l150", 6),
    _kuka("kuka_lbr_iiwa", "lbr_iiwa_14_r820", 7),
    RealRobot(
        "puma560", "rtbdata",
        "xacro/unimation_puma560_description/urdf/puma560_robot.urdf", "link7", 6,
    ),
)  # fmt: skip


def each(robots: tuple[RealRobot, ...]) -> list[object]:
    """Parameters for a test; all tests of a robot in one process, so that it is loaded once."""
    return [
        pytest.param(robot, id=robot.name, marks=pytest.mark.xdist_group(robot.name))
        for robot in robots
    ]
