"""Mesh files as triangles with colours, for formats and colours that MuJoCo does not read."""

from __future__ import annotations

from collections.abc import Sequence
from functools import lru_cache
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
import numpy.typing as npt

from qp_twist.errors import InvalidInput
from qp_twist.files import check_regular, read_bytes
from qp_twist.robots.wording import reason_of

if TYPE_CHECKING:
    import trimesh

Colour = tuple[float, float, float, float]
_KINDS = (".dae", ".obj", ".stl")


class ColouredMesh(NamedTuple):
    """Triangles of one colour."""

    vertices: npt.NDArray[np.float32]
    """In the units of the file, those of DAE in m, (V, 3)."""
    faces: npt.NDArray[np.int32]
    """Indices of the vertices, (F, 3)."""
    colour: Colour | None
    """Red, green, blue and opacity, 0 to 1; ``None`` if the file states none."""
    area: float


def coloured_meshes(file: Path) -> tuple[ColouredMesh, ...]:
    """The triangles of a STL, OBJ or DAE file, those of each colour as a mesh.

    A DAE file is scaled to metres by its ``<unit>``; its ``<up_axis>`` is ignored, as in ROS.

    Raises:
        InvalidInput: If it cannot be read.
    """
    check_regular(file, "mesh file")
    stat = file.stat()
    return _read(file, stat.st_mtime_ns, stat.st_size)


def msh(meshes: Sequence[ColouredMesh]) -> bytes:
    """Meshes as one file of MuJoCo's binary format: it is written and read at once."""
    firsts = np.cumsum([0, *(len(mesh.vertices) for mesh in meshes[:-1])], dtype=np.int32)
    vertices = np.vstack([mesh.vertices for mesh in meshes])
    faces = np.vstack([mesh.faces + first for mesh, first in zip(meshes, firsts, strict=True)])
    counts = np.array([len(vertices), 0, 0, len(faces)], dtype=np.int32)
    return counts.tobytes() + vertices.tobytes() + faces.astype(np.int32).tobytes()


def read_parts(file: Path) -> tuple[list[trimesh.Trimesh], float]:
    """The parts of a mesh file, in the axes of the file, and metres for its unit: DAE states it.

    It and the files that it names (materials, textures) must be regular.

    Raises:
        InvalidInput: If it is no STL, OBJ or DAE file, cannot be read, or has no triangles.
    """
    import trimesh  # half a second

    class RegularFiles(trimesh.resolvers.FilePathResolver):
        def get(self, name: str) -> bytes:
            place = Path(self.parent, name.strip())
            found = place if place.exists() else place.with_name(place.name)
            return read_bytes(found)

    suffix = file.suffix.lower()
    if suffix not in _KINDS:
        raise InvalidInput("expected a mesh, STL, OBJ or DAE, by its suffix")
    check_regular(file, "mesh file")
    try:
        scene = trimesh.load_scene(file, resolver=RegularFiles(str(file)))
        dumped: list[Any] = scene.dump()
        parts = [part for part in dumped if len(getattr(part, "faces", ())) > 0]
    except Exception as error:  # whatever a reader raises about the content
        raise InvalidInput(f"cannot be read as a mesh ({reason_of(error)[:120]})") from error
    if not parts:
        raise InvalidInput("there are no triangles in it")
    if not all(np.isfinite(part.vertices).all() for part in parts):
        raise InvalidInput("a coordinate is NaN or infinite")
    return parts, _metres(scene) if suffix == ".dae" else 1.0


@lru_cache(maxsize=256)
def _read(file: Path, changed: int, size: int) -> tuple[ColouredMesh, ...]:
    import trimesh

    parts, scale = read_parts(file)
    by_colour: dict[Colour | None, list[trimesh.Trimesh]] = {}
    for part in parts:
        by_colour.setdefault(_colour(part), []).append(part)
    found = []
    for colour, some in by_colour.items():
        whole: Any = trimesh.util.concatenate(some)
        vertices = (scale * whole.vertices).astype(np.float32)
        area = scale**2 * float(whole.area)
        found.append(ColouredMesh(vertices, whole.faces.astype(np.int32), colour, area))
    found = [mesh for mesh in found if mesh.area > 0.0]
    if not found:
        raise InvalidInput("its triangles have no area")
    return tuple(sorted(found, key=lambda mesh: -mesh.area))


def _metres(scene: trimesh.Scene) -> float:
    """Metres for one unit of a DAE file."""
    stated = [part.metadata.get("units") for part in scene.geometry.values()]
    text = next((text for text in stated if text), "meters")
    number, star, _ = str(text).partition("*")
    return float(number) if star else 1.0


def _colour(part: trimesh.Trimesh) -> Colour | None:
    """The colour of a mesh's material, or of its faces."""
    visual: Any = part.visual
    if visual is None or not visual.defined:
        return None
    of = visual.material if visual.kind == "texture" else visual
    main = getattr(of, "main_color", None)
    if main is None or len(main) != 4:
        return None
    r, g, b, a = (round(float(v) / 255.0, 4) for v in main)
    return r, g, b, a if a > 0.0 else 1.0
