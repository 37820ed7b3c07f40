"""Solids of a cell from mesh files: tools, parts and fixtures."""

from __future__ import annotations

import importlib.util
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

import numpy as np

from qp_twist.checks import clause
from qp_twist.errors import InvalidInput
from qp_twist.files import LENGTHS
from qp_twist.robots import read_parts

if TYPE_CHECKING:
    import trimesh

MeshUnit = Literal["mm", "m"]

_CONVEX = 1.05
"""A hull with up to this times the mesh's volume stands for the mesh."""
_LARGE, _SMALL = 20.0, 2e-3
"""Sizes, m, beyond which the unit is questioned."""
_FLAT = 1e-6
"""Thickness, as a share of the size, below which a mesh encloses nothing."""


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
    drawn: trimesh.Trimesh
    pieces: tuple[trimesh.Trimesh, ...]
    notes: tuple[str, ...]


def read_solid(name: str, file: Path, unit: MeshUnit | None) -> Solid:
    """Read a mesh file (STL, OBJ or DAE), whose format does not state its unit reliably.

    Raises:
        InvalidInput: If there is no unit, or no solid in the file.
    """
    if unit is None:
        raise InvalidInput(
            f"{file}: a mesh file does not say its unit; add --mesh-units mm or --mesh-units m."
        )
    import trimesh  # half a second

    try:
        mesh: Any = trimesh.util.concatenate(read_parts(file)[0])
    except InvalidInput as error:
        raise InvalidInput(f"{clause(error)}; give a mesh (STL, OBJ or DAE).", file=file) from error
    mesh.apply_scale(LENGTHS[unit])
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
    return Solid(name, mesh, pieces, tuple(notes))


def convex_pieces(name: str, mesh: trimesh.Trimesh) -> tuple[tuple[trimesh.Trimesh, ...], str]:
    """Convex pieces of a concave mesh by coacd, if it is installed, and a sentence about them.

    There are none where the convex hull stands for the mesh.
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
    return tuple(piece.convex_hull for piece in pieces), f"{text}."


def _divided(mesh: trimesh.Trimesh) -> list[trimesh.Trimesh]:
    import coacd
    import trimesh

    coacd.set_log_level("error")
    found = coacd.run_coacd(coacd.Mesh(mesh.vertices, mesh.faces), seed=0)
    pieces = [trimesh.Trimesh(vertices, faces) for vertices, faces in found]
    return [piece for piece in pieces if piece.convex_hull.volume > 0.0]
