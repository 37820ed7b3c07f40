"""Solids of a cell from mesh files: tools, parts and fixtures."""

from __future__ import annotations

import importlib.util
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

import numpy as np

from qp_twist.checks import Array, clause
from qp_twist.errors import InvalidInput
from qp_twist.files import check_regular
from qp_twist.robots import load_meshes

if TYPE_CHECKING:
    import trimesh

MeshUnit = Literal["mm", "m"]

_FORMATS = (".stl", ".obj", ".dae")
_METRES = {"mm": 1e-3, "m": 1.0}
_CONVEX = 1.05
"""A hull with up to this times the mesh's volume stands for the mesh."""
_LARGE, _SMALL = 20.0, 2e-3
"""Sizes, m, beyond which the unit is questioned."""
_FLAT = 1e-6
"""Thickness, as a share of the size, below which a mesh encloses nothing."""


@dataclass(frozen=True, eq=False)
class Mesh:
    """Vertices, m, (V, 3), and triangles, indices of vertices, (F, 3)."""

    vertices: Array
    faces: Any

    def obj(self) -> str:
        """The text of an OBJ file."""
        lines = ["v " + " ".join(f"{x:.9g}" for x in vertex) for vertex in self.vertices]
        lines += ["f " + " ".join(str(k + 1) for k in face) for face in self.faces]
        return "\n".join(lines) + "\n"


@dataclass(frozen=True, eq=False)
class Solid:
    """A solid from a mesh file, in the axes of the file, m.

    Attributes:
        name: Its name in the scene.
        drawn: The mesh.
        pieces: Convex pieces that stand for it where distances are computed; empty if its convex
            hull does.
        notes: Sentences on what was decided.
    """

    name: str
    drawn: Mesh
    pieces: tuple[Mesh, ...]
    notes: tuple[str, ...]


def read_solid(name: str, file: Path, unit: MeshUnit | None) -> Solid:
    """Read a mesh file.

    A concave mesh is divided into convex pieces by coacd if it is installed.

    Args:
        name: Name in the scene.
        file: STL, OBJ or DAE.
        unit: Unit of its coordinates; no mesh format states it reliably.

    Raises:
        InvalidInput: If there is no unit, or no solid in the file.
    """
    if unit is None:
        raise InvalidInput(
            f"{file}: a mesh file does not say its unit; add --mesh-units mm or --mesh-units m."
        )
    mesh = _read(file)
    mesh.vertices = _METRES[unit] * mesh.vertices
    size = mesh.extents
    widths = np.linalg.svd(mesh.vertices - mesh.vertices.mean(axis=0), compute_uv=False)
    if widths[-1] <= _FLAT * widths[0]:
        raise InvalidInput(
            f"{file}: is flat, and a distance is computed between solids; give it a thickness."
        )
    notes = []
    if size.max() > _LARGE or size.max() < _SMALL:
        other = "m" if size.max() < _SMALL else "mm"
        doubt = "check the file" if other == unit else f"is the file in {other}?"
        notes.append(f"{file.name}: it is {size.max():.3g} m across: {doubt}")
    pieces, note = convex_pieces(file.name, mesh)
    if note:
        notes.append(note)
    return Solid(name, Mesh(mesh.vertices, mesh.faces), pieces, tuple(notes))


def _read(file: Path) -> trimesh.Trimesh:
    import trimesh  # half a second

    suffix = file.suffix.lower()
    if suffix not in _FORMATS:
        raise InvalidInput(f"{file}: expected a mesh, STL, OBJ or DAE, by its suffix; convert it.")
    check_regular(file, "mesh file")
    try:
        mesh = load_meshes(file).to_mesh()
    except Exception as error:  # whatever a reader raises about the content
        raise InvalidInput(f"{file}: cannot be read as a mesh: {clause(error)}.") from error
    if not isinstance(mesh, trimesh.Trimesh) or not len(mesh.faces):
        raise InvalidInput(f"{file}: there are no triangles in it; export it as a mesh.")
    if not np.isfinite(mesh.vertices).all():
        raise InvalidInput(f"{file}: a coordinate is NaN or infinite; mend it in the file.")
    return mesh


def convex_pieces(name: str, mesh: trimesh.Trimesh) -> tuple[tuple[Mesh, ...], str]:
    """Convex pieces of a concave mesh, as far as they can be made, and a sentence about them.

    Args:
        name: What the sentence calls it.
        mesh: The mesh, m.

    Returns:
        The pieces, none where the convex hull stands for the mesh, and the sentence.
    """
    hull = mesh.convex_hull
    closed = bool(mesh.is_watertight) and mesh.volume > 0.0
    ratio = float(hull.volume / mesh.volume) if closed else np.inf
    if ratio <= _CONVEX:
        return (), ""
    larger = f"{ratio:.3g} times the volume of the mesh" if closed else (
        "of unknown excess, since the mesh is not closed"
    )  # fmt: skip
    if importlib.util.find_spec("coacd") is None:
        return (), (
            f"{name}: distances are those of its convex hull, {larger}; with pip install "
            "qp_twist[cell] it is divided into convex pieces, or model it as several files."
        )
    pieces = _divided(mesh)
    if len(pieces) < 2:
        return (), f"{name}: distances are those of its convex hull, {larger}."
    volume = sum(float(piece.convex_hull.volume) for piece in pieces)
    text = f"{name}: divided into {len(pieces)} convex pieces"
    if closed:
        text += f", {volume / mesh.volume:.3g} times the volume of the mesh (its hull {ratio:.3g})"
    hulls = [piece.convex_hull for piece in pieces]
    return tuple(Mesh(piece.vertices, piece.faces) for piece in hulls), f"{text}."


def _divided(mesh: trimesh.Trimesh) -> list[trimesh.Trimesh]:
    import coacd
    import trimesh

    coacd.set_log_level("error")
    found = coacd.run_coacd(coacd.Mesh(mesh.vertices, mesh.faces), seed=0)
    pieces = [trimesh.Trimesh(vertices, faces) for vertices, faces in found]
    return [piece for piece in pieces if piece.convex_hull.volume > 0.0]
