"""Toolpaths as programs write them, each with its true path computed by other means.

A module is a dialect. Its inputs are made up after real files: their words, their order, their
numbers. Beside each stands a function that computes the path without the package: arcs by angle,
rotary axes by homogeneous matrices, splines by scipy, Euler angles by scipy's rotations.
"""

import importlib
import pkgutil
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
import numpy.typing as npt
from scipy.spatial.transform import Rotation

from qp_twist.paths import Toolpath, read_toolpath

Array = npt.NDArray[np.float64]
UP = np.array([0.0, 0.0, 1.0])


@dataclass(frozen=True)
class TruePath:
    """A curve of a file as it really is.

    Attributes:
        points: Dense points of it, or its corners if it is straight between them, m, (N, 3).
        vectors: Tool axes or normals there, (N, 3); ``None`` if the file has none.
        rotations: Of the tool there, (N, 3, 3), likewise.
        feed: Of the whole curve, m/s; ``None`` if it is not compared.
    """

    points: Array
    vectors: Array | None = None
    rotations: Array | None = None
    feed: float | None = None


@dataclass(frozen=True)
class Case:
    """An input and its path.

    Attributes:
        dialect: Who writes such files.
        file: Name of the file.
        text: Its contents.
        path: Its curves.
        options: Of the reader, if the file needs any.
    """

    dialect: str
    file: str
    text: str | bytes
    path: list[TruePath]
    options: dict[str, object] = field(default_factory=dict)

    def read(self, folder: Path) -> Toolpath:
        """Read it as a user would."""
        file = folder / self.file
        file.write_bytes(self.text if isinstance(self.text, bytes) else self.text.encode())
        return read_toolpath(file, **self.options)

    def __str__(self) -> str:
        return f"{self.dialect}: {self.file}"


CASES: list[Case] = []


def case(
    dialect: str, file: str, text: str | bytes, path: list[TruePath] | None = None,
    **options: object,
) -> Callable[[Callable[[], list[TruePath]]], None]:  # fmt: skip
    """Add an input with its path, or with that which the function that is decorated computes."""

    def add(compute: Callable[[], list[TruePath]]) -> None:
        CASES.append(Case(dialect, file, text, compute(), options))

    if path is not None:
        add(lambda: path)
    return add


def mm(*points: tuple[float, float, float]) -> Array:
    """Points in millimetres as metres, (N, 3)."""
    return 1e-3 * np.array(points, dtype=np.float64)


def at(x: float, y: float, z: float) -> Array:
    """A point in millimetres as metres, (3,)."""
    return 1e-3 * np.array([x, y, z])


def up(points: Array) -> Array:
    """The tool axis of a machine of three axes at each point."""
    return np.tile(UP, (len(points), 1))


def upright(*parts: Array, feed: float | None = None) -> TruePath:
    """A curve of some parts, one after the other, on such a machine."""
    points = np.vstack(parts)
    return TruePath(points, up(points), feed=feed)


def held(turn: Rotation, *parts: Array, feed: float | None = None) -> TruePath:
    """A curve of some parts along which the tool keeps its orientation."""
    points = np.vstack(parts)
    return TruePath(points, rotations=np.tile(turn.as_matrix(), (len(points), 1, 1)), feed=feed)


def arc(centre: Array, begin: Array, axis: Array, angle: float, rise: float = 0.0) -> Array:
    """Points of an arc or helix about an axis through ``centre``, right-handed by ``angle``, rad.

    Rodrigues' formula on the radius vector; ``rise`` along the axis in proportion to the angle.
    """
    axis = np.asarray(axis) / np.linalg.norm(axis)
    radius = begin - centre
    shares = np.linspace(0.0, 1.0, 721)[:, None]
    cos, sin = np.cos(angle * shares), np.sin(angle * shares)
    along = axis * (radius @ axis)
    turned = cos * (radius - along) + sin * np.cross(axis, radius) + along
    return centre + turned + rise * shares * axis


for _module in pkgutil.iter_modules(__path__):
    importlib.import_module(f"{__name__}.{_module.name}")
