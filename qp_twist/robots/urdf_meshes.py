"""The mesh files of a URDF: found, read, and renamed for MuJoCo; sentences on missing ones."""

from __future__ import annotations

import copy
import os
import re
import xml.etree.ElementTree as ET
from collections.abc import Iterator, Mapping
from functools import lru_cache
from pathlib import Path
from typing import NamedTuple
from urllib.parse import unquote

import mujoco

from qp_twist.checks import clause
from qp_twist.errors import InvalidInput
from qp_twist.files import is_folder, read_bytes
from qp_twist.robots.mesh_files import Colour, ColouredMesh, coloured_meshes, msh
from qp_twist.robots.ros_packages import how_to_state, package_folders
from qp_twist.robots.wording import free_name, listed, reason_of

_IN_PACKAGE = re.compile(r"(?:package|model)://([^/]+)/(.+)")
VISUAL = "visual_"
"""Begin of the names of meshes that are only drawn."""


_GREY: Colour = (0.72, 0.74, 0.77, 1.0)


class Meshes(NamedTuple):
    """The meshes of a file."""

    assets: dict[str, bytes]
    """Their contents, by their new names in the tree."""
    stated: dict[str, str]
    """Their names in the file, by the same new names."""
    left_out: list[str]


def take_meshes(root: ET.Element, file: Path, packages: Mapping[str, Path]) -> Meshes:
    """Read the mesh files of a URDF; remove shapes whose mesh is not found or cannot be read.

    The tree gets short names, one for each file and scale, since MuJoCo's reader identifies files
    by name. A mesh that is drawn becomes one for each colour of its file, unless the URDF states
    its colour. Visual shapes are left out if MuJoCo's settings in the file say
    ``discardvisual="true"``.
    """
    folder = file.parent / _settings(root)
    missing: dict[str, None] = {}
    refused: dict[str, str] = {}
    assets: dict[str, bytes] = {}
    originals: dict[str, str] = {}
    names: dict[tuple[Path, str | None, str], list[str]] = {}
    for link, shape, mesh in mesh_shapes(root):
        stated = mesh.get("filename", "")
        found = _found(stated, file, folder, packages)
        if found is None:
            missing[stated] = None
            link.remove(shape)
            continue
        try:
            parts = coloured_meshes(found) if _is_converted(shape, found) else ()
            contents = [msh([part]) for part in parts] or [read_bytes(found, "mesh")]
            if shape.tag != "visual" and parts:
                contents = [msh(parts)]
        except InvalidInput as error:
            refused[stated] = clause(error)
            link.remove(shape)
            continue
        key = (found, mesh.get("scale"), shape.tag)
        if key not in names:
            names[key] = []
            for content in contents:
                stem = f"{VISUAL * (shape.tag == 'visual')}{found.stem}"
                # MuJoCo names meshes by the stem.
                name = free_name(stem, {Path(name).stem for name in assets})
                name += ".msh" if parts else found.suffix
                assets[name], originals[name] = content, stated
                names[key].append(name)
        mesh.set("filename", names[key][0])
        if shape.tag == "visual":
            _colour(link, shape, names[key], parts)
    return Meshes(assets, originals, [*_not_found([*missing], file, packages), *sentence(refused)])


def sentence(refused: Mapping[str, str]) -> list[str]:
    """A sentence on meshes that cannot be read, by name with the reason; none without any."""
    reasons = "; ".join(dict.fromkeys(refused.values()))
    return [f"Not readable: {listed('mesh', list(refused))}; {reasons}."] if refused else []


def mesh_shapes(root: ET.Element) -> Iterator[tuple[ET.Element, ET.Element, ET.Element]]:
    """Link, shape and mesh of every mesh shape; shapes may be removed during the iteration."""
    for link in root.findall("link"):
        for shape in [*link.findall("visual"), *link.findall("collision")]:
            mesh = shape.find("geometry/mesh")
            if mesh is not None:
                yield link, shape, mesh


@lru_cache(maxsize=1024)
def refused_mesh(name: str, content: bytes) -> str:
    """Why MuJoCo refuses a mesh that only collides or is drawn, or ``""``."""
    trial = mujoco.MjSpec()
    trial.assets = {name: content}
    trial.add_mesh(name="trial", file=name, inertia=mujoco.mjtMeshInertia.mjMESH_INERTIA_SHELL)
    trial.worldbody.add_geom(type=mujoco.mjtGeom.mjGEOM_MESH, meshname="trial")
    try:
        trial.compile()
    except ValueError as error:
        return f"MuJoCo refuses it ({reason_of(error)[:120]})"
    return ""


def _is_converted(shape: ET.Element, found: Path) -> bool:
    """Whether a mesh is converted: those that are drawn for their colours, and DAE files."""
    return shape.tag == "visual" or found.suffix.lower() == ".dae"


def _colour(
    link: ET.Element, shape: ET.Element, names: list[str], parts: tuple[ColouredMesh, ...]
) -> None:
    """Make one visual shape for each part of a mesh, in the part's colour if it has none."""
    own = shape.find("material")
    shapes = [shape, *(copy.deepcopy(shape) for _ in names[1:])]
    for each, name, part in zip(shapes, names, parts, strict=True):
        if each is not shape:
            link.insert(list(link).index(shape) + names.index(name), each)
            each.find("geometry/mesh").set("filename", name)  # type: ignore[union-attr]
        if own is None:
            _add_material(each, f"colour of {name}", part.colour or _GREY)


def _add_material(shape: ET.Element, name: str, colour: Colour) -> None:
    material = ET.SubElement(shape, "material", name=name)
    ET.SubElement(material, "color", rgba=" ".join(map(str, colour)))


def _settings(root: ET.Element) -> str:
    """Change MuJoCo's settings in the file to what its reader is to do; the folder of meshes.

    Visual shapes stay in the tree, unless the file discards them, each with a colour, since MuJoCo
    would give a shape without one that of the shape before.
    """
    extension = root.find("mujoco")
    if extension is None:
        extension = ET.Element("mujoco")
        root.insert(0, extension)  # it has to be the first
    compiler = extension.find("compiler")
    compiler = ET.SubElement(extension, "compiler") if compiler is None else compiler
    folder = compiler.attrib.pop("meshdir", "")
    for attribute in ("assetdir", "strippath"):
        compiler.attrib.pop(attribute, None)
    discards = compiler.get("discardvisual") == "true"
    compiler.set("discardvisual", "false")
    for link in root.findall("link"):
        for shape in link.findall("visual"):
            if discards:
                link.remove(shape)
            elif shape.find("material") is None and shape.find("geometry/mesh") is None:
                _add_material(shape, "no colour", _GREY)
    return folder


def _found(stated: str, file: Path, folder: Path, packages: Mapping[str, Path]) -> Path | None:
    """The mesh file, or ``None``; finally try the bare name, as MuJoCo does.

    Files made on other systems have backslashes, blanks as ``%20``, and names in another case.
    """
    plain = unquote(stated.strip().replace("\\", "/"))
    places = [*_places(stated, file, folder, packages), *_places(plain, file, folder, packages)]
    there = (p for p in places if os.path.lexists(p) and not is_folder(p))
    in_other_case = (found for p in places if (found := _in_other_case(p)) is not None)
    return next(there, None) or next(in_other_case, None)


def _places(stated: str, file: Path, folder: Path, packages: Mapping[str, Path]) -> Iterator[Path]:
    """Where a mesh may be, the most likely first."""
    in_package = _IN_PACKAGE.fullmatch(stated)
    if in_package:
        package, rest = in_package[1], in_package[2]
        yield from (folder / rest for folder in package_folders(package, file, packages))
    else:
        plain = stated.removeprefix("file://")
        yield from (file.parent / plain, folder / plain)
    yield folder / Path(stated).name


def _in_other_case(place: Path) -> Path | None:
    """The only file whose path differs from ``place`` in upper and lower case alone, if any."""
    found = Path(place.anchor)
    for name in place.relative_to(place.anchor).parts:
        if not os.path.lexists(found / name):
            try:
                alike = [p.name for p in found.iterdir() if p.name.casefold() == name.casefold()]
            except OSError:
                return None
            if len(alike) != 1:
                return None
            [name] = alike  # noqa: PLW2901
        found /= name
    return None if is_folder(found) else found


def _not_found(missing: list[str], file: Path, packages: Mapping[str, Path]) -> list[str]:
    """A sentence for each package, and one for the other files."""
    by_package: dict[str, list[str]] = {}
    for stated in missing:
        in_package = _IN_PACKAGE.fullmatch(stated)
        by_package.setdefault(in_package[1] if in_package else "", []).append(stated)
    sentences = []
    for package, files in by_package.items():
        folders = package_folders(package, file, packages) if package else iter(())
        known = next((folder for folder in folders if is_folder(folder)), None)
        if known is not None:
            sentences.append(
                f"Not found in the package {package!r} ({known}): {listed('mesh', files)}."
            )
        elif package:
            count = f"{len(files)} mesh{'' if len(files) == 1 else 'es'}"
            sentences.append(
                f"Not found: {count} of the package {package!r}. {how_to_state(package)}"
            )
        else:
            sentences.append(f"Not found: {listed('mesh', files)}.")
    return sentences
